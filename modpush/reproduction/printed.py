"""The printed figures that ours stand beside."""

from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

from modpush.evaluation.published_results import PAPER, PaperFigures, printed_spl
from modpush.reproduction.cells import SHOWN
from modpush.reproduction.verdicts import against_printed

__all__ = ["PAPER_METRICS", "judge", "printed_rows", "stands_for"]

PAPER_METRICS = ("success", "contact_rate", "collision_rate", "spl", "path_length")
"""Metrics of the paper's tables."""
_AGENT, _CONTROLLER = "paper: agent", "paper: controller"


@dataclass(frozen=True)
class _Row:
    name: str
    figures: dict[str, float]


def stands_for(metric: str, row: str, metrics: Sequence[str], evaluation_set: str | None) -> str:
    """Our column that is compared with a printed figure: measured as there, if the rows have it.

    Args:
        metric: The printed metric.
        row: Name of the printed row.
        metrics: Our columns.
        evaluation_set: The paper's set.
    """
    as_there = {
        "contact_rate": "contact_rate_at_end",
        "spl": printed_spl(evaluation_set or "", of_controller=row == _CONTROLLER),
    }.get(metric, metric)
    return as_there if as_there in metrics else metric


def printed_rows(evaluation_set: str | None) -> list[_Row]:
    """The paper's rows of a set: its agent, its controller, and its retrained agent if there is one."""
    figures = PAPER.get(evaluation_set or "")
    if figures is None:
        return []
    rows = [
        _Row(_AGENT, _column(figures, 0)),
        _Row(_CONTROLLER, _column(figures, 1)),
    ]
    if figures.retrained:
        known = {name: figures.retrained[name] for name in PAPER_METRICS}
        rows.append(_Row(f"{_AGENT}, retrained", known))
    return rows


def _column(figures: PaperFigures, which: int) -> dict[str, float]:
    pairs = {name: getattr(figures, name) for name in PAPER_METRICS}
    return {name: pair[which] for name, pair in pairs.items() if pair is not None}


def judge(cells: pd.DataFrame, evaluation_set: str | None) -> pd.DataFrame:
    """Verdicts on all methods against the paper's rows of a set.

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
    for method, own in cells.groupby("method", sort=False):
        by_metric = own.set_index("metric")
        for row in printed_rows(evaluation_set):
            for metric, printed in row.figures.items():
                ours = stands_for(metric, row.name, metrics, evaluation_set)
                cell = by_metric.loc[ours]
                verdict = against_printed(metric, cell, printed, runs) if cell["count"] else None
                if verdict is not None:
                    about = {"method": method, "versus": row.name, "metric": metric, "ours": ours}
                    figures = {name: cell[name] for name in ("mean", "low", "high")}
                    lines.append({**about, **figures, "theirs": printed, "verdict": verdict})
    return pd.DataFrame(lines)
