"""Train the autoencoder of local windows.

    python examples/collect_windows.py            # the data, some minutes
    python examples/train_vae.py                  # the default
    python examples/train_vae.py paper            # the paper's schedule, on 700k windows

Writes to the output folder: `log.csv` (held-out figures during training), `checkpoint.pt`, and at
the end `depth_vae.safetensors`, which `DepthVAE.from_pretrained` loads. Run the same command again to
continue where it was stopped; the result is the same as without the stop. `examples/report_vae.py` shows
what was learned.
"""

import csv
import dataclasses
import os
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import torch
import tyro
from tensordict import TensorDict
from torch import Tensor
from tqdm import tqdm
from vae_quality import vae_quality
from window_data import WindowData, augment_windows

from modpush.encoders import DepthVAE, VAELoss


@dataclass(frozen=True, kw_only=True)
class Config:
    """Settings of the training."""

    data: Path = Path("runs/windows/train.safetensors")
    """File of windows, written by `collect_windows.py`."""
    output: Path = Path("runs/vae")
    """Folder to write to."""
    images: int = 2_400_000
    """Number of windows to train on, repetitions included."""
    batch_size: int = 256
    """Number of windows in a step."""
    lr: float = 3e-3
    """Learning rate of Adam: the highest one of the schedule."""
    schedule: Literal["one_cycle", "constant"] = "one_cycle"
    """Schedule of the learning rate."""
    augment: bool = True
    """Turn and mirror windows, and lay them over each other."""
    latent_dim: int = 32
    """Number of values in a latent."""
    kl_weight: float = 0.5
    """Weight of the KL divergence."""
    encoder_widths: tuple[int, int, int, int] = (16, 32, 64, 96)
    """Numbers of channels of the encoder's convolutions."""
    decoder_widths: tuple[int, int, int, int] = (96, 64, 32, 16)
    """Numbers of channels of the decoder's layers."""
    eval_every: int = 100_000
    """Number of windows between two evaluations, each with a checkpoint."""
    eval_windows: int = 2000
    """Number of held-out windows in an evaluation."""
    precision: Literal["float32", "bfloat16"] = "float32"
    """Precision of the networks' layers; "bfloat16" is faster on a processor with AMX or AVX512-BF16.
    Weights, optimizer and losses are float32 with both."""
    threads: int = 2
    """Number of threads of torch."""
    seed: int = 0
    """Seed of the first weights and of the batches."""
    stop_at: int | None = field(default=None)
    """Number of windows after which to stop as if interrupted; the schedule stays that of `images`."""


PRESETS = {
    "default": (
        "Reaches the held-out loss of the paper's schedule in a third of the windows.",
        Config(),
    ),
    "paper": (
        "Adam 1e-4, ten times through 700k windows, no augmentation (Sec. IV-A).",
        Config(
            data=Path("runs/windows/paper.safetensors"),
            output=Path("runs/vae_paper"),
            images=7_000_000,
            lr=1e-4,
            schedule="constant",
            augment=False,
        ),
    ),
}


class Training:
    """Everything that a checkpoint holds."""

    def __init__(self, config: Config) -> None:
        torch.manual_seed(config.seed)
        self.config, self.step, self.seconds = config, 0, 0.0
        self.order: tuple[int, Tensor] | None = None
        vae = DepthVAE(config.latent_dim, config.encoder_widths, config.decoder_widths)
        self.loss = VAELoss(vae)
        self.loss.kl_weight = config.kl_weight
        self.optimizer = torch.optim.Adam(self.loss.parameters(), lr=config.lr, fused=True)
        self.total = -(-config.images // config.batch_size)
        if config.schedule == "one_cycle":
            self.schedule: Any = torch.optim.lr_scheduler.OneCycleLR(
                self.optimizer, config.lr, total_steps=self.total + 1, pct_start=0.1
            )
        else:
            self.schedule = torch.optim.lr_scheduler.ConstantLR(self.optimizer, 1.0)

    def batch(self, data: WindowData) -> Tensor:
        """The windows of this step: each epoch in an order of its own."""
        size, count = self.config.batch_size, len(data)
        first = self.step * size
        epoch, start = divmod(first, count - count % size or count)
        if self.order is None or self.order[0] != epoch:
            generator = torch.Generator().manual_seed(self.config.seed * 1_000_003 + epoch)
            self.order = epoch, torch.randperm(count, generator=generator)
        windows = data.floats(self.order[1][start : start + size])
        if self.config.augment:
            others = data.floats(torch.randint(count, (len(windows),)))
            windows = augment_windows(windows, others)
        return windows

    def advance(self, data: WindowData) -> None:
        """One step. What is random in it depends on seed and step only, so that a resume is exact."""
        torch.manual_seed((self.config.seed << 40) + self.step)
        begun = time.perf_counter()
        batch = TensorDict(window=self.batch(data))
        reduced = self.config.precision == "bfloat16"
        with torch.autocast("cpu", torch.bfloat16, enabled=reduced):
            losses = self.loss(batch)
        total = losses["loss_reconstruction"] + losses["loss_kl"]
        if not total.isfinite():
            raise RuntimeError(f"train_vae: the loss of step {self.step} is {total.item()}.")
        self.optimizer.zero_grad()
        total.backward()
        self.optimizer.step()
        self.schedule.step()
        self.step += 1
        self.seconds += time.perf_counter() - begun

    def save(self, path: Path) -> None:
        """Write a checkpoint, whole or not at all."""
        parts = {
            name: getattr(self, name).state_dict() for name in ("loss", "optimizer", "schedule")
        }
        state = {**parts, "step": self.step, "seconds": self.seconds, "config": recipe(self.config)}
        torch.save(state, path.with_suffix(".tmp"))
        os.replace(path.with_suffix(".tmp"), path)

    def load(self, path: Path) -> None:
        """Take a checkpoint over.

        Raises:
            ValueError: If it was made with another config; the message says what differs.
        """
        state = torch.load(path, weights_only=True)
        mine = recipe(self.config)
        if differing := {k for k in mine if mine[k] != state["config"].get(k)}:
            raise ValueError(f"train_vae: {path} was made with other {sorted(differing)}.")
        for name in ("loss", "optimizer", "schedule"):
            getattr(self, name).load_state_dict(state[name])
        self.step, self.seconds = state["step"], state["seconds"]


def recipe(config: Config) -> dict[str, Any]:
    """The fields on which the weights depend, as plain data."""
    plain = {k: list(v) if isinstance(v, tuple) else v for k, v in vars(config).items()}
    for name in ("data", "output", "eval_every", "eval_windows", "threads", "stop_at"):
        del plain[name]
    return plain


def log(path: Path, row: dict[str, float]) -> None:
    """Append a row, dropping rows that a resumed run has come before again."""
    rows: list[dict[str, str]] = []
    if path.exists():
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
    kept = [old for old in rows if int(old["images"]) < row["images"]]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(row))
        writer.writeheader()
        writer.writerows([*kept, row])


def main(config: Config) -> DepthVAE:
    """Train, or continue training."""
    torch.set_num_threads(config.threads)
    data = WindowData.load(config.data)
    train, held_out = data.where(~data.held_out), data.where(data.held_out)
    if len(train) < config.batch_size or not len(held_out):
        raise ValueError(
            f"train_vae: {config.data} has {len(train)} windows to train on and {len(held_out)} held "
            f"out, expected at least {config.batch_size} and 1."
        )
    training, checkpoint = Training(config), config.output / "checkpoint.pt"
    if checkpoint.exists():
        training.load(checkpoint)
    config.output.mkdir(parents=True, exist_ok=True)
    size, vae = config.batch_size, training.loss.vae
    last = min(training.total, -(-(config.stop_at or config.images) // size))
    with tqdm(total=config.images, initial=training.step * size, unit="img") as bar:
        while training.step < last:
            training.advance(train)
            bar.update(size)
            at_end = training.step == last
            if at_end or training.step % max(config.eval_every // size, 1) == 0:
                quality = vae_quality(vae, held_out.floats, min(len(held_out), config.eval_windows))
                figures = dataclasses.asdict(quality)
                figures.pop("kl_per_latent")
                progress = {"images": training.step * size, "seconds": round(training.seconds, 1)}
                log(config.output / "log.csv", {**progress, **figures})
                training.save(checkpoint)
                bar.set_postfix(loss=f"{quality.loss:.1f}", iou=f"{quality.iou:.3f}")
    card = {"data": data.config, "training": recipe(config), "images": training.step * size}
    vae.eval().save(config.output / "depth_vae.safetensors", card)
    print(f"{config.output / 'depth_vae.safetensors'}: {training.seconds:.0f} s of training")
    return vae


if __name__ == "__main__":
    arguments = sys.argv[1:]
    if not arguments or arguments[0] not in (*PRESETS, "--help"):
        arguments = ["default", *arguments]
    main(tyro.extras.overridable_config_cli(PRESETS, args=arguments))
