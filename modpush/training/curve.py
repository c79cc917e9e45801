"""Learning curves as a picture."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib
import pandas as pd

matplotlib.use("Agg")  # no screen is needed
import matplotlib.pyplot as plt
from matplotlib.ticker import EngFormatter

_PANELS = (
    ("success", "success, greedy, held-out", (0.0, 1.02)),
    ("contact_rate", "contact rate", (0.0, 1.02)),
    ("collision_rate_object", "object collision rate", (0.0, None)),
)


def draw_curve(
    runs: Sequence[Path] | Mapping[str, Path],
    path: Path,
    *,
    against: str | Sequence[str] = "minutes",
) -> None:
    """Draw the evaluations of some runs.

    Args:
        runs: Run folders, or run folders by the name to show. Where they were evaluated in different
            scene families, success is the mean over those in common.
        path: The picture's file.
        against: The horizontal axis: `"minutes"`, `"step"` or `"updates"`; several make a row each.

    Raises:
        FileNotFoundError: If a folder holds no evaluations.
    """
    named = runs if isinstance(runs, Mapping) else _by_name(runs)
    tables = {name: pd.read_csv(folder / "evaluations.csv") for name, folder in named.items()}
    success_in_common([*tables.values()])
    rows = [against] if isinstance(against, str) else list(against)
    size = 5 * len(_PANELS), 3.6 * len(rows)
    figure, grid = plt.subplots(len(rows), len(_PANELS), figsize=size, squeeze=False)
    for axes, unit in zip(grid, rows, strict=True):
        for axis, (column, title, limits) in zip(axes, _PANELS, strict=True):
            for name, table in tables.items():
                axis.plot(table[unit], table[column], marker=".", label=name)
            axis.set(title=title, xlabel=unit)
            if unit != "minutes":  # six digits would run into each other
                axis.xaxis.set_major_formatter(EngFormatter(sep=""))
            axis.set_ylim(*limits)  # after all curves: the first one's top would cut the others off
            axis.grid(alpha=0.3)
    grid[0, 0].legend(loc="lower right")
    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _by_name(runs: Sequence[Path]) -> dict[str, Path]:
    """Each run by its folder's name, or by its path where two have the same."""
    names = [run.name for run in runs]
    return {run.name if names.count(run.name) == 1 else str(run): run for run in runs}


def success_in_common(tables: Sequence[pd.DataFrame]) -> list[str]:
    """Make success comparable: its mean over the scene families that all tables have, in place.

    Args:
        tables: Evaluations of runs, with success by family in columns `success/<family>`.

    Returns:
        The families in common.
    """
    sets = [{c for c in table if str(c).startswith("success/")} for table in tables]
    common = sorted(set.intersection(*sets)) if sets else []
    for table, own in zip(tables, sets, strict=True):
        if common and own != set(common):
            table["success"] = table[common].mean(axis=1)
    return [column.partition("/")[2] for column in common]
