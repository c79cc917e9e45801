"""Learning curves as a picture."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib
import numpy as np
import pandas as pd

matplotlib.use("Agg")  # no screen is needed
import matplotlib.pyplot as plt
from matplotlib.axes import Axes

__all__ = ["draw_curve"]

_PANELS = (
    ("success", "success, greedy, held-out", (0.0, 1.02)),
    ("contact_rate", "contact rate", (0.0, 1.02)),
    ("collision_rate_object", "object collision rate", (0.0, None)),
)


def draw_curve(
    runs: Sequence[Path] | Mapping[str, Sequence[Path]], path: Path, *, against: str = "minutes"
) -> None:
    """Draw the evaluations of some runs.

    Args:
        runs: Run folders; or groups of them, one colour each, with the mean over their runs.
        path: The picture's file.
        against: The horizontal axis: `"minutes"`, `"step"` or `"updates"`.

    Raises:
        FileNotFoundError: If a folder holds no evaluations.
    """
    groups = runs if isinstance(runs, Mapping) else {run.name: [run] for run in runs}
    figure, axes = plt.subplots(1, len(_PANELS), figsize=(5 * len(_PANELS), 3.6))
    for colour, (label, folders) in enumerate(groups.items()):
        tables = [pd.read_csv(Path(folder) / "evaluations.csv") for folder in folders]
        for axis, (column, _, _) in zip(axes, _PANELS, strict=True):
            _draw_group(axis, tables, column, against, f"C{colour}", label)
    for axis, (_, title, limits) in zip(axes, _PANELS, strict=True):
        axis.set(title=title, xlabel=against)
        axis.set_ylim(*limits)  # after all curves: the first one's top would cut the others off
        axis.grid(alpha=0.3)
    axes[0].legend(loc="lower right")
    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _draw_group(
    axis: Axes, tables: list[pd.DataFrame], column: str, against: str, colour: str, label: str
) -> None:
    for table in tables:
        axis.plot(
            table[against],
            table[column],
            color=colour,
            alpha=1.0 if len(tables) == 1 else 0.3,
            marker=".",
            label=label if len(tables) == 1 else None,
        )
    if len(tables) > 1:
        end = min(table[against].max() for table in tables)
        at = np.linspace(max(table[against].min() for table in tables), end, 100)
        curves = [np.interp(at, table[against], table[column]) for table in tables]
        axis.plot(at, np.mean(curves, 0), color=colour, linewidth=2, label=label)
