"""What the runs of a sweep came to, as tables and a picture."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from modpush._arguments import checked_arguments
from modpush.files import write_text
from modpush.sweeps.definition import Trial
from modpush.sweeps.figure import draw_sweep
from modpush.sweeps.trial import is_finished, trial_error
from modpush.training.held_out import held_out_score

__all__ = ["METRICS", "sweep_curves", "sweep_results", "trial_row", "write_results"]

METRICS = ("success", "spl", "contact_rate", "collision_rate", "collision_rate_object")
"""What is taken over from the greedy evaluations on the held-out episodes."""


def trial_row(trial: Trial, folder: Path) -> dict[str, Any]:
    """State of a run, and its last and best evaluation.

    The best evaluation is the one by which `Trainer` chooses the best agent (`held_out_score`).
    """
    run = trial.folder(folder)
    finished = is_finished(trial, folder)
    error = "" if finished else trial_error(run)
    row: dict[str, Any] = {
        "variant": trial.variant.name,
        "group": trial.variant.group,
        "seed": trial.seed,
        "state": "finished" if finished else "failed" if error else "unfinished",
        "error": error,
        "total_steps": trial.config.total_steps,
    }
    if not run.evaluations.exists():
        return row
    table = pd.read_csv(run.evaluations)
    last = table.iloc[-1]
    best = table.loc[table.apply(held_out_score, axis="columns").idxmax()]
    row |= {name: float(last[name]) for name in ("step", "updates", "minutes")}
    row |= {f"final_{name}": float(last[name]) for name in METRICS}
    row |= {"best_step": int(best["step"])}
    row |= {f"best_{name}": float(best[name]) for name in METRICS}
    return row


@checked_arguments
def sweep_results(trials: Sequence[Trial], folder: Path | str) -> pd.DataFrame:
    """A row for each trial: variant, group, seed, state, last and best evaluation."""
    return pd.DataFrame([trial_row(trial, Path(folder)) for trial in trials])


@checked_arguments
def sweep_curves(trials: Sequence[Trial], folder: Path | str) -> pd.DataFrame:
    """A row for each evaluation of each trial: variant, group, seed, step, minutes, metrics."""
    tables = []
    for trial in trials:
        run = trial.folder(Path(folder))
        if run.evaluations.exists():
            table = pd.read_csv(run.evaluations)
            about = {"variant": trial.variant.name, "group": trial.variant.group}
            columns = ["step", "updates", "minutes", *METRICS]
            tables.append(table[columns].assign(seed=trial.seed, **about))
    if not tables:
        return pd.DataFrame()
    everything = pd.concat(tables, ignore_index=True)
    first = ["variant", "group", "seed"]
    return everything[[*first, *(c for c in everything if c not in first)]]


def write_results(trials: Sequence[Trial], folder: Path) -> pd.DataFrame:
    """Write `trials.csv`, `curves.csv` and `curves.png`; returns the first."""
    results, curves = sweep_results(trials, folder), sweep_curves(trials, folder)
    write_text(folder / "trials.csv", results.to_csv(index=False))
    if len(curves):
        write_text(folder / "curves.csv", curves.to_csv(index=False))
        draw_sweep(curves, folder / "curves.png", baseline=trials[0].variant.name)
    return results
