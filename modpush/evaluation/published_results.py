"""The results that the paper printed, for comparison with ours."""

from dataclasses import dataclass

import pandas as pd

from modpush.evaluation.tables import METRICS

__all__ = ["PAPER", "PaperFigures", "beside_paper"]


@dataclass(frozen=True, kw_only=True)
class PaperFigures:
    """One set's results in the paper: of its learned agent, and of Krivic and Piater's controller."""

    success: tuple[float, float]
    contact_rate: tuple[float, float]
    collision_rate: tuple[float, float] | None
    spl: tuple[float, float]
    path_length: tuple[float, float]
    """[m]"""


PAPER = {
    "free/small_cube": PaperFigures(
        success=(1.000, 0.998),
        contact_rate=(0.943, 0.870),
        collision_rate=None,
        spl=(0.928, 0.918),
        path_length=(0.429, 0.430),
    ),
    "obstacles/small_cube": PaperFigures(
        success=(0.980, 0.955),
        contact_rate=(0.995, 0.850),
        collision_rate=(0.008, 0.011),
        spl=(0.910, 0.952),
        path_length=(0.523, 0.513),
    ),
    "obstacles/large_cube": PaperFigures(
        success=(0.977, 0.957),
        contact_rate=(0.995, 0.851),
        collision_rate=(0.007, 0.012),
        spl=(0.910, 0.954),
        path_length=(0.520, 0.510),
    ),
    "obstacles/small_cylinder": PaperFigures(
        success=(0.967, 0.945),
        contact_rate=(0.981, 0.889),
        collision_rate=(0.021, 0.014),
        spl=(0.839, 0.940),
        path_length=(0.553, 0.512),
    ),
    "obstacles/fragment": PaperFigures(
        success=(0.867, 0.953),
        contact_rate=(0.980, 0.868),
        collision_rate=(0.05, 0.024),
        spl=(0.71, 0.951),
        path_length=(0.630, 0.501),
    ),
    "hard/small_cube": PaperFigures(
        success=(0.88, 0.72),
        contact_rate=(0.977, 0.566),
        collision_rate=(0.065, 0.01),
        spl=(0.779, 0.720),
        path_length=(0.492, 0.550),
    ),
}
"""The paper's results by evaluation set. Source: the paper's tables of results (Sec. V)."""


def beside_paper(summary: pd.DataFrame, evaluation_set: str) -> pd.DataFrame:
    """A summary's means beside the paper's, cell by cell.

    Args:
        summary: What `summarize` returned.
        evaluation_set: Name of the set. Sets that the paper does not have get empty cells.

    Returns:
        By metric: a column for each method, then `paper_controller` and `paper_agent`.
    """
    table = summary[list(METRICS)].T.rename_axis("metric")
    table.columns.name = None
    figures = PAPER.get(evaluation_set)
    for column, which in (("paper_controller", 1), ("paper_agent", 0)):
        pairs = [getattr(figures, name, None) for name in METRICS]
        table[column] = [float("nan") if pair is None else pair[which] for pair in pairs]
    return table
