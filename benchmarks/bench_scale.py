"""Training with collectors on a Ray cluster beside the one process of a single machine.

    python benchmarks/bench_scale.py
    python benchmarks/bench_scale.py --steps 60000 --collectors 1 2 4

Training as the default process and with some numbers of Ray collectors, all with the same number of
environment steps. Ray is begun on this machine unless RAY_ADDRESS names a cluster.
"""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import tempfile
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pandas as pd
import torch
import tyro

from modpush.training import TRAIN_PRESETS, TrainConfig, Trainer


@dataclass(frozen=True, kw_only=True)
class ScaleConfig:
    """What is measured."""

    preset: str = "cpu"
    """Training preset."""
    steps: int = 60_000
    """Environment steps of each run."""
    collectors: tuple[int, ...] = (1, 2)
    """Numbers of Ray collectors."""
    evaluation_episodes: int = 120
    """Held-out episodes after the last step."""


def train(config: TrainConfig) -> dict[str, Any]:
    """One run, and what its log says of the time after the first updates."""
    with tempfile.TemporaryDirectory() as folder:
        trainer = Trainer(config, Path(folder) / "run")
        trainer.run()
        log = pd.read_csv(trainer.folder.log)
        evaluation = pd.read_csv(trainer.folder.evaluations).iloc[-1]
        late = log[log["step"] > config.tqc.learning_starts * 1.5]
        updates = config.rollout_length * config.env.num_envs * config.tqc.updates_per_step
        # While a rollout is made the learner learns from one more than from those of other collectors.
        behind = late.get("collector/behind", pd.Series([0.0])) + 1
        return {
            "steps/s": late["speed/steps"].median(),
            "updates/s": late["speed/updates"].median(),
            "learner waits": late["speed/waiting"].mean(),
            "updates behind": behind.mean() * updates,
            "success": evaluation["success"],
        }


def main(bench: ScaleConfig) -> None:
    torch.set_num_threads(1)
    base = replace(
        TRAIN_PRESETS[bench.preset],
        total_steps=bench.steps,
        evaluate_every=bench.steps,
        evaluation_episodes=bench.evaluation_episodes,
        checkpoint_every=10 * bench.steps,
        progress=False,
    )
    print(f"\npreset {bench.preset}, {bench.steps:,} steps, seed {base.seed}\n")
    print("| collection | steps/s | updates/s | learner waits | updates behind | success |")
    print("|---|---|---|---|---|---|")
    row("one process (default)", train(base))
    for number in bench.collectors:
        name = f"Ray, {number} collector{'s' * (number > 1)}"
        row(name, train(replace(base, collector="ray", num_collectors=number)))


def row(name: str, run: dict[str, Any]) -> None:
    print(
        f"| {name} | {run['steps/s']:.0f} | {run['updates/s']:.1f} | {run['learner waits']:.0%} | "
        f"{run['updates behind']:.0f} | {run['success']:.2f} |",
        flush=True,
    )


if __name__ == "__main__":
    warnings.filterwarnings("ignore", message="Failed to find system libvulkan")
    main(tyro.cli(ScaleConfig, description=__doc__))
