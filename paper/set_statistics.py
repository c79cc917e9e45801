"""Content of the evaluation sets: distances, free straight lines, and the yardsticks' lengths."""

import math
from collections.abc import Iterable

import numpy as np
import pandas as pd

from modpush.evaluation import EvaluationSet, load_set, shortest_path
from modpush.evaluation.tables import format_table
from paper.authors_paths import authors_agent_length, authors_controller_length

__all__ = ["set_statistics", "set_table"]


def set_statistics(episodes: EvaluationSet) -> dict[str, float]:
    """Means over the episodes of a set.

    Returns:
        `episodes`; `distance`, the mean distance from start to goal [m]; `under_0.3`, the share of
        those under 0.3 m; `straight`, the share of the episodes in which the straight line is free
        on the set's map; `shortest_length` [m]; and the mean ratios of the lengths by which the
        authors measured, `authors_agent` and `authors_controller`, to the shortest.
    """
    paths = [shortest_path(s, inflation=episodes.conditions.inflation) for s in episodes]
    shortest = np.array([length for _, length in paths])
    distance = np.array([math.dist(s.object_pose[:2], s.goal_position) for s in episodes])
    agent = np.array([authors_agent_length(s) for s in episodes])
    controller = np.array([authors_controller_length(s) for s in episodes])
    means = {
        "distance": distance,
        "under_0.3": distance < 0.3,
        "straight": [len(corners) == 2 for corners, _ in paths],
        "shortest_length": shortest,
        "authors_agent": agent / shortest,
        "authors_controller": controller / shortest,
    }
    return {"episodes": len(episodes)} | {name: float(np.mean(v)) for name, v in means.items()}


def set_table(names: Iterable[str]) -> str:
    """The statistics of sets in Markdown."""
    return format_table(
        pd.DataFrame({n: set_statistics(load_set(n)) for n in names}).T.rename_axis("set")
    )
