"""The printed figures that ours stand beside."""

from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

from modpush.evaluation.published_results import PAPER, PaperFigures, measured_as
from modpush.reproduction.cells import SHOWN
from modpush.reproduction.measure import RETRAINED
from modpush.reproduction.verdicts import against_printed

__all__ = ["PAPER_METRICS", "judge", "printed_rows", "stands_for"]

PAPER_METRICS = ("success", "contact_rate", "collision_rate", "spl", "path_length")
"""Metrics of the paper's tables."""
_AGENT, _CONTROLLER = "paper: agent", "paper: controller"
_AGENT_RETRAINED = f"{_AGENT}, retrained"


@dataclass(frozen=True)
class _Row:
    name: str
    episodes: int
    figures: dict[str, float]
    """By metric."""
    stds: dict[str, float]
    """Standard deviations of those metrics that the paper prints them of."""


def stands_for(metric: str, row: str, metrics: Sequence[str], evaluation_set: str | None) -> str:
    """Our column that is compared with a printed figure: measured as there, if the rows have it.

    Args:
        metric: The printed metric.
        row: Name of the printed row.
        metrics: Our columns.
        evaluation_set: The paper's set.
    """
    as_there = measured_as(evaluation_set or "", of_controller=row == _CONTROLLER)[metric]
    return as_there if as_there in metrics else metric


def printed_rows(evaluation_set: str | None) -> list[_Row]:
    """The paper's rows of a set: its agent, its controller, and its retrained agent if there is one."""
    figures = PAPER.get(evaluation_set or "")
    if figures is None:
        return []
    printed = {_AGENT: _column(figures, 0), _CONTROLLER: _column(figures, 1)}
    if figures.retrained:
        printed[_AGENT_RETRAINED] = dict(figures.retrained)
    return [
        _Row(
            name=name,
            episodes=figures.episodes,
            figures={metric: known[metric] for metric in PAPER_METRICS if metric in known},
            stds={m: known[f"{m}_std"] for m in PAPER_METRICS if f"{m}_std" in known},
        )
        for name, known in printed.items()
    ]


def _column(figures: PaperFigures, which: int) -> dict[str, float]:
    """One method's printed means, and its standard deviations as `<metric>_std`."""
    names = (*PAPER_METRICS, *(f"{name}_std" for name in PAPER_METRICS))
    pairs = {name: getattr(figures, name, None) for name in names}
    return {name: pair[which] for name, pair in pairs.items() if pair is not None}


def judge(cells: pd.DataFrame, evaluation_set: str | None) -> pd.DataFrame:
    """Verdicts on all methods against the paper's rows of a set.

    An agent that was trained further with the set's object is judged against the paper's agent that was
    trained further, and the other agents against the paper's that was not. Where one of the two is
    missing, ours or the paper's, all are judged against every row.

    Args:
        cells: What `make_cells` returned.
        evaluation_set: The paper's set; nothing is judged without one.

    Returns:
        A row for each method, printed row and metric: `method`, `versus`, `metric`, `ours` (our column),
        `mean`, `low`, `high`, `theirs`, `verdict`.
    """
    lines = []
    metrics = [name for name in SHOWN if name in set(cells["metric"])]
    runs = PAPER[evaluation_set].episodes if evaluation_set in PAPER else 0
    rows = printed_rows(evaluation_set)
    names = {row.name for row in rows}
    by_training = RETRAINED in set(cells["method"]) and _AGENT_RETRAINED in names
    for method, own in cells.groupby("method", sort=False):
        by_metric = own.set_index("metric")
        unlike = _AGENT if method == RETRAINED else _AGENT_RETRAINED
        for row in rows:
            if by_training and row.name == unlike:
                continue
            for metric, printed in row.figures.items():
                ours = stands_for(metric, row.name, metrics, evaluation_set)
                cell = by_metric.loc[ours]
                verdict = against_printed(metric, cell, printed, runs) if cell["count"] else None
                if verdict is not None:
                    about = {"method": method, "versus": row.name, "metric": metric, "ours": ours}
                    figures = {name: cell[name] for name in ("mean", "low", "high")}
                    lines.append({**about, **figures, "theirs": printed, "verdict": verdict})
    return pd.DataFrame(lines)
