"""Attentive replay against uniform, at equal budget: the same runs with one argument changed.

    python benchmarks/compare_replay.py                      # 3 seeds each, about 20 minutes on 2 cores
    python benchmarks/compare_replay.py --seeds 1 --steps 20000 --encoder rays

Each run takes turns in one process, so that a core is a run; `--jobs` of them run at a time. Finished
runs are not repeated, interrupted ones go on. Writes `runs/compare_replay/`, a sweep's folder for each
encoder and number of steps, and to `--out` a table of the evaluations and the curves as one picture.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import pandas as pd
import tyro

from modpush.sweeps import Sweep, Variant, run_sweep
from modpush.training.curve import draw_curve


@dataclass(frozen=True, kw_only=True)
class CompareConfig:
    """What is compared, and at which budget."""

    samplers: tuple[str, ...] = ("attentive", "uniform")
    """Samplers to compare, as values of `--train.replay.sampler`."""
    seeds: int = 3
    """Number of runs with each sampler."""
    steps: int = 150_000
    """Number of environment steps in each run."""
    encoder: Literal["vae", "rays"] = "vae"
    """Encoder of the local window."""
    jobs: int = 2
    """Number of runs at a time."""
    runs: Path = Path("runs/compare_replay")
    """Folder of the runs."""
    out: Path = Path("docs/results/training")
    """Folder of the table and the picture."""


def main(config: CompareConfig) -> None:
    sweep = Sweep(
        preset="cpu",
        overrides={
            "async_collection": False,
            "total_steps": config.steps,
            "env.encoder": config.encoder,
            "evaluate_every": 25_000,
            "evaluation_episodes": 60,
        },
        seeds=tuple(range(config.seeds)),
        variants=tuple(
            Variant(name=name, overrides={"replay.sampler": name}) for name in config.samplers
        ),
    )
    folder = config.runs / f"{config.encoder}_{config.steps}"
    run_sweep(sweep, folder, jobs=config.jobs)
    runs = {
        name: [folder / name / f"seed_{seed}" for seed in sweep.seeds] for name in config.samplers
    }
    draw_curve(runs, config.out / "replay_curves.png", against="step")
    tables = [
        pd.read_csv(path / "evaluations.csv").assign(sampler=name, seed=seed)
        for name, paths in runs.items()
        for seed, path in zip(sweep.seeds, paths, strict=True)
    ]
    table = pd.concat(tables)
    table.drop(columns="minutes").to_csv(config.out / "replay_curves.csv", index=False)
    shown = table.groupby(["sampler", "step"])["success"].agg(["mean", "min", "max"]).round(3)
    print(shown.to_string())


if __name__ == "__main__":
    main(tyro.cli(CompareConfig, description=__doc__))
