"""Training runs of several variants and seeds, each a process `modpush train`; resumable.

A sweep's file names a preset, the overrides common to all runs, the seeds and the variants, with
fields of `TrainConfig` by their dotted names. Its folder gets a run's folder for each variant and seed.
"""

import json
import os
import subprocess
import sys
import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from modpush._processes import interrupts_raised
from modpush._validation import from_plain
from modpush.files import parse_yaml
from modpush.training import TRAIN_PRESETS, TrainConfig
from paper.provenance import add_session

__all__ = ["Trial", "evaluations_of", "is_finished", "load_trials", "run_trials"]


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One training run of a sweep."""

    variant: str
    """Name of the variant; the first variant of a sweep is the one that the others are compared with."""
    group: str
    """Question that the variant answers; those of a group share a panel of the figure."""
    seed: int
    """The run's seed."""
    preset: str
    """Name of the preset, in `TRAIN_PRESETS`."""
    config: TrainConfig
    """The whole configuration."""

    @property
    def name(self) -> str:
        """Variant and seed, which is also the run's folder in that of the sweep."""
        return f"{self.variant}/seed_{self.seed}"


def load_trials(
    path: Path, groups: Collection[str] = (), total_steps: int | None = None
) -> tuple[Trial, ...]:
    """The trials of a sweep's file: all variants with the first seed, then with the next.

    Args:
        path: The YAML file.
        groups: Groups of variants besides the first variant; all by default.
        total_steps: Environment steps of each run, instead of what the file says.

    Raises:
        ValueError: If a group, a field or a value is unknown; the message names variant and field.
    """
    sweep = parse_yaml(path.read_bytes())
    first, *others = sweep["variants"]
    known = {variant.get("group", "all") for variant in others}
    if unknown := sorted(set(groups) - known):
        raise ValueError(f"{path}: groups must be some of {sorted(known)}, got {unknown}.")
    chosen = [first, *(v for v in others if not groups or v.get("group", "all") in groups)]
    plain = asdict(TRAIN_PRESETS[sweep["preset"]])
    always: dict[str, Any] = {"progress": False}
    always |= {} if total_steps is None else {"total_steps": total_steps}
    return tuple(
        Trial(
            variant=variant["name"],
            group=variant.get("group", "all"),
            seed=seed,
            preset=sweep["preset"],
            config=_override(
                f"{path}, variant {variant['name']!r}",
                plain,
                {
                    **sweep.get("overrides", {}),
                    **variant.get("overrides", {}),
                    **always,
                    "seed": seed,
                },
            ),
        )
        for seed in sweep.get("seeds", [0])
        for variant in chosen
    )


def _override(who: str, plain: Mapping[str, Any], overrides: Mapping[str, Any]) -> TrainConfig:
    data = json.loads(json.dumps(plain, default=str))
    for name, value in overrides.items():
        *folders, last = name.split(".")
        inside = data
        for folder in folders:
            if not isinstance(inside.get(folder), dict):
                raise ValueError(f"{who}: there is no field {name!r} in TrainConfig.")
            inside = inside[folder]
        inside[last] = value
    try:
        return from_plain(TrainConfig, data)
    except ValueError as error:
        raise ValueError(f"{who}: {error}") from None


def run_trials(trials: Sequence[Trial], folder: Path, jobs: int = 1) -> list[str]:
    """Train what is missing. A run that was killed continues from its newest checkpoint.

    Args:
        trials: The trials.
        folder: The sweep's folder.
        jobs: Number of runs at a time. A run with `async_collection` keeps two CPUs busy, one without
            it one; their results are the same.

    Returns:
        Names of the trials that failed; what they printed is in `<name>.txt` in the folder.

    Raises:
        KeyboardInterrupt: After SIGINT (Ctrl-C), SIGTERM or SIGHUP, once the runs' checkpoints are
            written.
        ValueError: If the folder holds a run of another configuration.
    """
    waiting = [trial for trial in trials if not is_finished(trial, folder)]
    running: dict[str, subprocess.Popen] = {}
    failed: list[str] = []
    if waiting:
        add_session(folder)
    with interrupts_raised():
        try:
            while waiting or running:
                while waiting and len(running) < jobs:
                    trial = waiting.pop(0)
                    print(f"{trial.name}: started, {len(waiting)} left", flush=True)
                    running[trial.name] = _start(trial, folder)
                time.sleep(0.5)
                for name in [
                    name for name, process in running.items() if process.poll() is not None
                ]:
                    if running.pop(name).returncode:
                        print(f"{name}: failed, see {folder / name}.txt", flush=True)
                        failed.append(name)
        finally:
            for process in running.values():
                process.terminate()  # each writes a checkpoint
            for process in running.values():
                process.wait()
    return failed


def _start(trial: Trial, folder: Path) -> subprocess.Popen:
    run, config = folder / trial.name, folder / f"{trial.name}.yaml"
    command = [sys.executable, "-m", "modpush", "train", trial.preset, "--out", str(run)]
    command += ["--config", str(config)]
    command += ["--resume"] if (run / "config.yaml").exists() else []
    run.parent.mkdir(parents=True, exist_ok=True)
    config.write_text(_config_text(trial), encoding="utf-8")
    with (folder / f"{trial.name}.txt").open("a", encoding="utf-8") as output:
        return subprocess.Popen(
            command,
            stdout=output,
            stderr=subprocess.STDOUT,
            env={"OMP_NUM_THREADS": "1", **os.environ},
            start_new_session=True,  # Ctrl-C reaches the sweep alone, which passes it on once
        )


def _config_text(trial: Trial) -> str:
    """The configuration as JSON, which is YAML as well."""
    return json.dumps(asdict(trial.config), default=str, indent=1)


def is_finished(trial: Trial, folder: Path) -> bool:
    """True if a run has been evaluated after its last step."""
    config = folder / f"{trial.name}.yaml"
    if config.exists() and config.read_text(encoding="utf-8") != _config_text(trial):
        raise ValueError(f"{config} is of another configuration; remove it and its run's folder.")
    table = evaluations_of(trial, folder)
    return table is not None and int(table["step"].max()) >= trial.config.total_steps


def evaluations_of(trial: Trial, folder: Path) -> pd.DataFrame | None:
    """Evaluations of a run; None if there is none yet."""
    path = folder / trial.name / "evaluations.csv"
    return pd.read_csv(path) if path.exists() else None
