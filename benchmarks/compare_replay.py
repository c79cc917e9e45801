"""Attentive replay against uniform, at equal budget: the same runs with one argument changed.

    python benchmarks/compare_replay.py                      # 3 seeds each, about 20 minutes on 2 cores
    python benchmarks/compare_replay.py --seeds 1 --steps 20000 --encoder rays

Each run takes turns in one process, so that a core is a run; `--jobs` of them run at a time. Finished
runs are not repeated. Writes `runs/compare_replay/<sampler>_<seed>/` and, to `--out`, a table of the
evaluations and the curves as one picture.
"""

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import pandas as pd
import tyro

from modpush.training.curve import draw_curve

TRAIN = (sys.executable, "-m", "modpush", "train")


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


def run(folder: Path, sampler: str, seed: int, config: CompareConfig) -> None:
    arguments = ["cpu", "--out", folder, "--train.no-async-collection", "--train.no-progress"]
    arguments += ["--train.replay.sampler", sampler, "--train.seed", seed]
    arguments += ["--train.total-steps", config.steps, "--train.env.encoder", config.encoder]
    arguments += ["--train.evaluate-every", 25_000, "--train.no-save-buffer"]
    arguments += ["--train.checkpoint-every", config.steps, "--train.evaluation-episodes", 60]
    subprocess.run([*TRAIN, *map(str, arguments)], check=True)


def main(config: CompareConfig) -> None:
    groups: dict[str, list[Path]] = {name: [] for name in config.samplers}
    with ThreadPoolExecutor(config.jobs) as pool:
        jobs = []
        for seed in range(config.seeds):
            for sampler, folders in groups.items():
                folder = config.runs / f"{sampler}_{seed}"
                folders.append(folder)
                if not (folder / "curve.png").exists():
                    jobs.append(pool.submit(run, folder, sampler, seed, config))
        for job in jobs:
            job.result()
    draw_curve(groups, config.out / "replay_curves.png", against="step")
    tables = [
        pd.read_csv(folder / "evaluations.csv").assign(sampler=name, seed=seed)
        for name, folders in groups.items()
        for seed, folder in enumerate(folders)
    ]
    table = pd.concat(tables)
    table.drop(columns="minutes").to_csv(config.out / "replay_curves.csv", index=False)
    shown = table.groupby(["sampler", "step"])["success"].agg(["mean", "min", "max"]).round(3)
    print(shown.to_string())


if __name__ == "__main__":
    main(tyro.cli(CompareConfig, description=__doc__))
