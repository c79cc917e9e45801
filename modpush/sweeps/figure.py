"""Learning curves of a sweep, a panel for each group of variants."""

import math
from pathlib import Path

import matplotlib
import numpy as np
import pandas as pd

matplotlib.use("Agg")  # no screen is needed
import matplotlib.pyplot as plt
from matplotlib.axes import Axes

__all__ = ["draw_sweep"]

_COLUMNS = 3


def draw_sweep(curves: pd.DataFrame, path: Path, baseline: str) -> None:
    """Draw the success of the held-out evaluations against the environment steps.

    Each panel has the variants of a group and, in black, the sweep's first variant: the mean over the
    seeds, and the range between the lowest and the highest of them.

    Args:
        curves: What `sweep_curves` returned, with at least one row.
        baseline: Name of the sweep's first variant, which may have no evaluation yet.
        path: The picture's file.
    """
    groups = dict.fromkeys(curves.loc[curves["variant"] != baseline, "group"]) or {"": None}
    rows, columns = math.ceil(len(groups) / _COLUMNS), min(_COLUMNS, len(groups))
    figure, axes = plt.subplots(
        rows,
        columns,
        figsize=(6.2 * columns, 3.3 * rows),
        squeeze=False,
        sharey=True,
        layout="constrained",
    )
    for axis in axes.flat[len(groups) :]:
        axis.axis("off")
    for axis, group in zip(axes.flat, groups, strict=False):
        first = curves[curves["variant"] == baseline]
        if len(first):
            _draw_variant(axis, first, baseline, "black")
        chosen = curves[(curves["group"] == group) & (curves["variant"] != baseline)]
        for number, (variant, table) in enumerate(chosen.groupby("variant", sort=False)):
            _draw_variant(axis, table, str(variant), f"C{number}")
        axis.set(title=str(group), xlabel="environment steps", ylim=(0.0, 1.02))
        axis.locator_params(axis="x", nbins=5)
        axis.grid(alpha=0.3)
        # Beside the panel, since a group of many variants would cover its own curves.
        axis.legend(fontsize="small", loc="upper left", bbox_to_anchor=(1.0, 1.0))
    for row in axes:
        row[0].set_ylabel("success, greedy, held-out")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _draw_variant(axis: Axes, table: pd.DataFrame, label: str, colour: str) -> None:
    by_seed = table.pivot_table(index="step", columns="seed", values="success")
    whole = by_seed.dropna()  # as far as all seeds have come
    steps = whole.index.to_numpy()
    axis.plot(steps, whole.mean(axis=1), color=colour, marker=".", label=label)
    if by_seed.shape[1] > 1 and np.size(steps):
        axis.fill_between(steps, whole.min(axis=1), whole.max(axis=1), color=colour, alpha=0.15)
