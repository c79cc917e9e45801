"""Measure and draw how well a trained autoencoder represents the local window.

    python examples/report_vae.py                                     # the shipped weights
    python examples/report_vae.py --weights runs/vae/depth_vae.safetensors

Needs the data of `collect_windows.py`, both files. Writes `metrics.json` and four pictures to the output
folder: windows above their reconstructions, samples of the prior, traversals of single latents,
and what each latent costs. Prints how well small networks read the clearance along 16 rays out of
the latent, beside what they read out of 32 principal components and of 32 random projections.
"""

import dataclasses
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import matplotlib
import numpy as np
import torch
import tyro
from torch import Tensor, nn
from vae_quality import encode_all, linear_probe, r_squared, vae_quality
from window_data import WindowData, augment_windows

from modpush.encoders import (
    DepthVAE,
    RayScan,
)

matplotlib.use("Agg")
from matplotlib import pyplot as plt

Encode = Callable[[Tensor], Tensor]


@dataclass(frozen=True, kw_only=True)
class Config:
    """Settings of the report."""

    weights: str = "depth_vae"
    """Name of shipped weights, or a file."""
    train: Path = Path("runs/windows/train.safetensors")
    """File of windows of the families that were trained on."""
    unseen: Path = Path("runs/windows/unseen.safetensors")
    """File of windows of families that were not trained on."""
    output: Path = Path("runs/vae_report")
    """Folder to write to."""
    probe_windows: int = 40_000
    """Number of windows that the probes are fitted on."""
    probe_epochs: int = 20
    """Number of epochs that the probing networks are trained for."""
    seed: int = 0
    """Seed of the probes, of the samples and of the choice of windows shown."""


def baselines(windows: Tensor, dim: int, seed: int) -> dict[str, Encode]:
    """Principal components and a fixed random projection, as encoders."""
    flat = windows.flatten(1)
    mean = flat.mean(0)
    _, _, components = torch.pca_lowrank(flat - mean, dim, center=False, niter=4)
    generator = torch.Generator().manual_seed(seed)
    projection = torch.randn(flat.shape[1], dim, generator=generator) / flat.shape[1] ** 0.5
    return {
        "pca": lambda window: (window.flatten(1) - mean) @ components,
        "random projection": lambda window: window.flatten(1) @ projection,
    }


def mlp_probe(
    train: tuple[Tensor, Tensor],
    test: tuple[Tensor, Tensor],
    *,
    width: int = 256,
    epochs: int = 40,
    seed: int = 0,
) -> float:
    """R² on the test part of a network with two hidden layers, fitted on the training part.

    Args:
        train: Latents `[N, d]` and targets `[N, T]`.
        test: The same of the test part.
        width: Width of the hidden layers.
        epochs: Number of passes over the training part.
        seed: Seed of the initialisation and of the order of the windows.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        mean, std = train[0].mean(0), train[0].std(0).clamp_min(1e-6)
        model = nn.Sequential(
            nn.Linear(train[0].shape[1], width),
            nn.ReLU(),
            nn.Linear(width, width),
            nn.ReLU(),
            nn.Linear(width, train[1].shape[1]),
        ).to(train[0].device)
        steps = epochs * -(-len(train[0]) // 256)
        optimizer = torch.optim.Adam(model.parameters(), fused=True)
        schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, 2e-3, total_steps=steps + 1)
        with torch.enable_grad():
            for _ in range(epochs):
                for rows in torch.randperm(len(train[0])).split(256):
                    error = model((train[0][rows] - mean) / std) - train[1][rows]
                    optimizer.zero_grad()
                    error.square().mean().backward()
                    optimizer.step()
                    schedule.step()
        with torch.no_grad():
            return r_squared(model((test[0] - mean) / std), test[1])


def probes(vae: DepthVAE, train: WindowData, unseen: WindowData, config: Config) -> dict[str, Any]:
    """R² of the clearance along 16 rays, for each encoder, probe, and way of splitting."""
    torch.manual_seed(config.seed)
    rows = torch.randperm(len(train))[: config.probe_windows]
    known = train.floats(rows)
    known = augment_windows(known, known.roll(1, 0))  # as the autoencoder saw them in training
    new = unseen.floats(torch.randperm(len(unseen)))
    half = len(new) // 2
    scan = RayScan(16)
    encoders: dict[str, Encode] = {"vae": vae, **baselines(known, vae.latent_dim, config.seed)}
    out: dict[str, Any] = {}
    for name, encoder in encoders.items():
        known_pair, half_pair, test_pair = (
            (encode_all(encoder, w.__getitem__, len(w)), encode_all(scan, w.__getitem__, len(w)))
            for w in (known, new[:half], new[half:])
        )
        epochs = config.probe_epochs
        out[name] = {
            "mlp, fitted on training families": mlp_probe(known_pair, test_pair, epochs=epochs),
            "linear, fitted on training families": linear_probe(known_pair, test_pair),
            "mlp, fitted on unseen families": mlp_probe(half_pair, test_pair, epochs=epochs),
            "linear, fitted on unseen families": linear_probe(half_pair, test_pair),
        }
    return out


def tiles(rows: list[Tensor], scale: int = 2) -> np.ndarray:
    """Windows `[n, 1, 64, 64]` a row, as one grey picture with lines between."""
    lines = [torch.nn.functional.pad(row[:, 0], (1, 1, 1, 1), value=0.4) for row in rows]
    picture = torch.cat([torch.cat(list(line), 1) for line in lines], 0)
    levels = (picture.clamp(0, 1) * 255).byte().numpy()
    return cv2.resize(levels, None, fx=scale, fy=scale, interpolation=cv2.INTER_NEAREST)


@torch.no_grad()
def pictures(vae: DepthVAE, unseen: WindowData, kl: tuple[float, ...], config: Config) -> None:
    """Write the four pictures."""
    generator = torch.Generator().manual_seed(config.seed)
    rows: list[Tensor] = []
    for family in range(len(unseen.config["families"]) - 1):
        full = (unseen.windows > 127).flatten(1).float().mean(1)
        candidates = ((unseen.family == family) & (full > 0.05)).nonzero()[:, 0]
        chosen = candidates[torch.randperm(len(candidates), generator=generator)[:12]]
        window = unseen.floats(chosen)
        rows += [window, vae.reconstruct(window)]
    cv2.imwrite(str(config.output / "reconstructions.png"), tiles(rows))
    prior = vae.decode(torch.randn(48, vae.latent_dim, generator=generator)).sigmoid()
    cv2.imwrite(str(config.output / "prior_samples.png"), tiles(list(prior.split(12))))

    latent = vae(rows[-2][:1])
    strongest = sorted(range(vae.latent_dim), key=lambda k: -kl[k])[:8]
    steps = []
    for k in strongest:
        moved = latent.repeat(11, 1)
        moved[:, k] = torch.linspace(-2.5, 2.5, 11)
        steps.append(vae.decode(moved).sigmoid())
    cv2.imwrite(str(config.output / "traversals.png"), tiles(steps))

    figure, axis = plt.subplots(figsize=(7, 2.5), layout="constrained")
    axis.bar(range(vae.latent_dim), sorted(kl, reverse=True))
    axis.set(xlabel="latent, by cost", ylabel="KL [nat]")
    figure.savefig(config.output / "kl_per_latent.png", dpi=100)
    plt.close(figure)


def main(config: Config) -> dict[str, Any]:
    """Measure, print, draw."""
    torch.manual_seed(config.seed)
    config.output.mkdir(parents=True, exist_ok=True)
    vae = DepthVAE.from_pretrained(config.weights)
    data, unseen = WindowData.load(config.train), WindowData.load(config.unseen)
    held_out = data.where(data.held_out)
    sets = {"held out, training families": held_out, "unseen families": unseen}
    for k, name in enumerate(unseen.config["families"][:-1]):
        sets[name] = unseen.where(unseen.family == k)
    metrics: dict[str, Any] = {
        name: dataclasses.asdict(vae_quality(vae, some.floats, len(some)))
        for name, some in sets.items()
    }
    pictures(vae, unseen, metrics["unseen families"]["kl_per_latent"], config)
    for name, row in metrics.items():
        shown = {k: round(v, 4) for k, v in row.items() if k != "kl_per_latent"}
        print(f"{name}: {shown}")
    metrics["clearance along 16 rays, R²"] = probes(vae, data.where(~data.held_out), unseen, config)
    for name, row in metrics["clearance along 16 rays, R²"].items():
        print(f"{name}: { {k: round(v, 3) for k, v in row.items()} }")
    (config.output / "metrics.json").write_text(
        json.dumps(metrics, indent=1, ensure_ascii=False), encoding="utf-8"
    )
    return metrics


if __name__ == "__main__":
    main(tyro.cli(Config))
