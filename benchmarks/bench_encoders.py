"""Times the local window, the encoders and the autoencoder's training beside their peers, in one run.

    python benchmarks/bench_encoders.py [--threads 1] [--clock wall|cpu] [--training-rounds 0]

Ours and the peers are timed in turn, so that a loaded machine slows all of them alike; `--clock cpu`
counts this process's own time, for machines that others work on.
"""

import argparse
import math
import time
from collections.abc import Callable

import cv2
import numba
import numpy as np
import torch
from tensordict import TensorDict
from torch import Tensor, nn
from torch.nn.functional import (
    affine_grid,
    binary_cross_entropy_with_logits,
    grid_sample,
    softplus,
)

from modpush.encoders import (
    ConvEncoder,
    DepthVAE,
    RayScan,
    VAELoss,
    egocentric_window,
)
from modpush.encoders.vae.model import kl_divergence
from modpush.geometry import Label

Clock = Callable[[], float]


class AuthorsVAE(nn.Module):
    """Widths and strides of the authors' code, 32/64/64/128, in torch's default layout."""

    def __init__(self, six_deconvolutions: bool = False) -> None:
        super().__init__()

        def norm(layer: nn.Module, channels: int) -> list[nn.Module]:
            return [layer, nn.BatchNorm2d(channels), nn.LeakyReLU(0.2)]

        self.encoder = nn.Sequential(
            *norm(nn.Conv2d(1, 32, 3, 2, 1), 32),
            nn.MaxPool2d(2),
            *norm(nn.Conv2d(32, 64, 3, 2, 1), 64),
            *norm(nn.Conv2d(64, 64, 3, 2, 1), 64),
            nn.MaxPool2d(2),
            *norm(nn.Conv2d(64, 128, 3, 2, 1), 128),
            nn.Flatten(),
            nn.Linear(128, 64),
        )
        wide = [128, 128] if six_deconvolutions else []
        layers: list[nn.Module] = [nn.Linear(32, 8192), nn.Unflatten(1, (128, 8, 8))]
        for channels in wide:
            layers += norm(nn.ConvTranspose2d(128, channels, 3, 1, 1), channels)
        before = 128
        for channels in (128, 64, 32):
            layers += norm(nn.ConvTranspose2d(before, channels, 3, 2, 1, 1), channels)
            before = channels
        self.decoder = nn.Sequential(*layers, nn.ConvTranspose2d(32, 1, 3, 1, 1))

    def forward(self, window: Tensor) -> Tensor:
        return self.encoder(window)[:, :32]

    def loss(self, window: Tensor) -> Tensor:
        mean, spread = self.encoder(window).chunk(2, -1)
        std = softplus(spread) + 1e-4
        logits = self.decoder(mean + std * torch.randn_like(std))
        likelihood = binary_cross_entropy_with_logits(logits, window, reduction="sum")
        return likelihood / len(window) + 0.5 * kl_divergence(mean, std).sum(1).mean()


def in_turn(
    tasks: dict[str, Callable[[], object]], rounds: int, clock: Clock
) -> dict[str, list[float]]:
    """Seconds of each call, one call of each after the other."""
    times: dict[str, list[float]] = {name: [] for name in tasks}
    for task in tasks.values():
        task()
    for _ in range(rounds):
        for name, task in tasks.items():
            begun = clock()
            task()
            times[name].append(clock() - begun)
    return times


def table(title: str, times: dict[str, list[float]], per_call: dict[str, float], unit: str) -> None:
    """Medians and least values, each divided by how much a call does (or the other way, a rate)."""
    print(f"\n### {title}\n\n| what | median {unit} | best {unit} |\n|---|---|---|")
    for name, seconds in times.items():
        shown = [per_call[name] * float(value) for value in (np.median(seconds), min(seconds))]
        if unit == "img/s":
            shown = [per_call[name] / float(value) for value in (np.median(seconds), min(seconds))]
        print(f"| {name} | {shown[0]:.4g} | {shown[1]:.4g} |")


def scene(batch: int) -> tuple[Tensor, Tensor, Tensor]:
    """A table with two bars, the object between them: depth, segmentation, poses."""
    depth = torch.full((batch, 256, 256), 1.1)
    labels = torch.zeros(batch, 256, 256, dtype=torch.uint8)
    for rows, columns, height, label in (
        (slice(100, 117), slice(60, 160), 0.06, Label.OBSTACLE),
        (slice(150, 167), slice(100, 200), 0.06, Label.OBSTACLE),
        (slice(127, 141), slice(120, 134), 0.05, Label.OBJECT),
    ):
        depth[:, rows, columns], labels[:, rows, columns] = 1.1 - height, label
    pose = torch.tensor([0.577, 0.002, 0.5]).repeat(batch, 1)
    return depth, labels, pose


def bench_window(rounds: int, clock: Clock) -> None:
    """Ours cuts, removes, sets upright and scales; the peers only cut a float picture."""
    tasks: dict[str, Callable[[], object]] = {}
    per_call: dict[str, float] = {}
    for batch in (1, 8):
        depth, labels, pose = scene(batch)
        height = (1.1 - depth) / 0.08
        turn = np.deg2rad(30)
        matrix = np.array(
            [[math.cos(turn), -math.sin(turn), 100], [math.sin(turn), math.cos(turn), 90]]
        )

        pictures = height.numpy()

        def warp(height: np.ndarray = pictures, matrix: np.ndarray = matrix) -> None:
            for image in height:
                cv2.warpAffine(image, matrix, (64, 64), flags=cv2.INTER_LINEAR)

        def sample(height: Tensor = height, turn: float = float(turn)) -> None:
            theta = 0.25 * torch.tensor(
                [[math.cos(turn), -math.sin(turn), 0], [math.sin(turn), math.cos(turn), 0]]
            )
            grid = affine_grid(
                theta.expand(len(height), 2, 3), [len(height), 1, 64, 64], align_corners=False
            )
            grid_sample(height[:, None], grid, align_corners=False)

        def ours(images: tuple[Tensor, Tensor, Tensor] = (depth, labels, pose)) -> None:
            egocentric_window(*images)

        def plain(images: tuple[Tensor, Tensor, Tensor] = (depth, labels, pose)) -> None:
            egocentric_window(*images, upright=False)

        for name, task in {
            "egocentric_window": ours,
            "egocentric_window(upright=False)": plain,
            "cv2.warpAffine, cut only": warp,
            "torch grid_sample, cut only": sample,
        }.items():
            tasks[f"{name}, {batch} scenes"] = task
            per_call[f"{name}, {batch} scenes"] = 1e6 / batch
    table("Window, µs a scene", in_turn(tasks, rounds, clock), per_call, "µs")


def bench_encode(rounds: int, clock: Clock) -> None:
    encoders: dict[str, nn.Module] = {
        "DepthVAE": DepthVAE().eval(),
        "authors' widths": AuthorsVAE().eval(),
        "ConvEncoder": ConvEncoder().eval(),
        "RayScan": RayScan().eval(),
    }
    tasks: dict[str, Callable[[], object]] = {}
    per_call: dict[str, float] = {}
    for batch in (1, 8):
        window = torch.rand(batch, 1, 64, 64)
        for name, encoder in encoders.items():

            def run(encoder: nn.Module = encoder, window: Tensor = window) -> None:
                encoder(window)

            tasks[f"{name}, {batch} windows"] = run
            per_call[f"{name}, {batch} windows"] = 1e3 / batch
    with torch.no_grad():
        times = in_turn(tasks, rounds, clock)
    table("Encode, ms a window", times, per_call, "ms")


def bench_training(rounds: int, clock: Clock) -> None:
    window = torch.rand(256, 1, 64, 64)
    loss, tasks = VAELoss(DepthVAE()), {}
    optimizer = torch.optim.Adam(loss.parameters(), fused=True)

    def ours() -> None:
        losses = loss(TensorDict(window=window))
        optimizer.zero_grad()
        (losses["loss_reconstruction"] + losses["loss_kl"]).backward()
        optimizer.step()

    tasks["DepthVAE, VAELoss"] = ours
    for name, six in (("authors' decoder", False), ("six full-width deconvolutions", True)):
        vae = AuthorsVAE(six)
        theirs = torch.optim.Adam(vae.parameters(), fused=True)

        def run(vae: AuthorsVAE = vae, theirs: torch.optim.Adam = theirs) -> None:
            theirs.zero_grad()
            vae.loss(window).backward()
            theirs.step()

        tasks[name] = run
    times = in_turn(tasks, rounds, clock)
    table("Training, batch 256, images a second", times, dict.fromkeys(tasks, 256.0), "img/s")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--clock", choices=("wall", "cpu"), default="wall")
    parser.add_argument("--rounds", type=int, default=300)
    parser.add_argument("--training-rounds", type=int, default=3)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    numba.set_num_threads(min(options.threads, numba.config.NUMBA_NUM_THREADS))
    cv2.setNumThreads(options.threads)
    clock = time.perf_counter if options.clock == "wall" else time.process_time
    print(f"torch {torch.__version__}, {options.threads} threads, {options.clock} clock")
    bench_window(options.rounds, clock)
    bench_encode(options.rounds, clock)
    if options.training_rounds:
        bench_training(options.training_rounds, clock)


if __name__ == "__main__":
    main()
