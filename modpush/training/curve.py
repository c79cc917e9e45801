"""A run's learning curve as a picture."""

from pathlib import Path

import matplotlib
import pandas as pd

matplotlib.use("Agg")  # no screen is needed
import matplotlib.pyplot as plt

_PANELS = (
    ("success", "success, greedy, held-out", (0.0, 1.02)),
    ("contact_rate", "contact rate", (0.0, 1.02)),
    ("collision_rate_object", "object collision rate", (0.0, None)),
)


def draw_curve(evaluations: Path, path: Path) -> None:
    """Draw the table of a run's evaluations (`evaluations.csv`) over its minutes of training.

    Raises:
        FileNotFoundError: If there is no such table.
    """
    table = pd.read_csv(evaluations)
    figure, axes = plt.subplots(1, len(_PANELS), figsize=(5 * len(_PANELS), 3.6))
    for axis, (column, title, limits) in zip(axes, _PANELS, strict=True):
        axis.plot(table["minutes"], table[column], marker=".")
        axis.set(title=title, xlabel="minutes", ylim=limits)
        axis.grid(alpha=0.3)
    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)
