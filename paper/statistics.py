"""Figures of several methods on the same episodes: intervals, tests, and verdicts beside the paper.

A verdict calls the first of two figures ahead, level or behind by the rules in `RULES`.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
import pandas as pd
from scipy import stats

from modpush.evaluation.tables import PairedTest, bootstrap_interval, paired_t_test
from paper.published import AGENT, AGENT_RETRAINED, CONTROLLER, measured_as, printed_rows

__all__ = [
    "OVER_ALL",
    "RETRAINED",
    "RULES",
    "SHOWN",
    "Verdict",
    "against_method",
    "against_printed",
    "judge",
    "make_cells",
    "make_tests",
    "mean_of",
    "stands_for",
]

Verdict = Literal["ahead", "level", "behind"]
RETRAINED = "fragment"
"""Name of our agent that was trained further with the fragment, as one of the paper's was."""
SHOWN = (
    "success",
    "contact_rate",
    "contact_rate_at_end",
    "collision_rate",
    "collision_rate_at_end",
    "collision_rate_object_at_end",
    "spl",
    "spl_authors_agent",
    "spl_authors_controller",
    "path_length",
    "mean_jerk",
    "reversal_rate",
)
"""Metrics of the tables, of which those are shown that all rows have."""
OVER_ALL = ("success", "spl", "spl_authors_agent", "spl_authors_controller")
"""Metrics that are taken over all episodes; the others over those that both methods solved."""
_LOWER_IS_BETTER = ("collision_rate", "path_length", "mean_jerk", "reversal_rate")
_LEVEL = 0.05  # significance level of all tests
_FEWEST = 30  # bootstrapped intervals of fewer episodes are too narrow
RULES = f"""1. Against a method that was measured here on the same episodes: ahead or behind where the
   two-sided paired t-test rejects equal means at 0.05, else level.
2. Against a printed success rate: ahead or behind where Fisher's exact test of the numbers of
   successes, ours and those that the printed rate stands for, gives p < 0.05, else level.
3. Against another printed figure: ahead or behind where the 95 % interval of our mean leaves it out,
   else level. The printed figure's own uncertainty is not known, so that these verdicts are a little
   bolder than tests would be. Where all our values are equal, the interval is that of the rule of
   three: of n values 3 more could have been 0 or 1.
4. Path lengths are not judged against printed ones: they depend on the episodes that were drawn. Nor
   are means over fewer than {_FEWEST} episodes, but for success rates.
"""
"""The rules in Markdown."""


def mean_of(rows: pd.DataFrame, metric: str) -> float:
    """Mean of a metric over all episodes, or over the solved ones, as in all tables."""
    return float((rows if metric in OVER_ALL else rows[rows["success"]])[metric].mean())


def make_cells(rows: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """Means of each method and metric, with their 95 % intervals.

    As in the paper, success and SPL are over all episodes and the other metrics over those that both
    methods of a pair solved. The pair of every method is the first one with it; that of the first is
    the first controller.

    Args:
        rows: A row for each episode by method, the agent first. All have the same episodes.

    Returns:
        A row for each method and metric: `method`, `metric`, `pair`, `count` of episodes, `mean`, `low`
        and `high` of the interval (Wilson's for success, else bootstrapped), `std`.

    Raises:
        ValueError: If the methods ran different episodes.
    """
    _check_same(rows)
    first = next(iter(rows))
    controller = next((name for name in rows if name.startswith("corridor")), first)
    lines = []
    for method, frame in rows.items():
        pair = controller if method == first else first
        for metric, values, _ in _pairs(frame, rows[pair], _shown(rows)):
            line = {"method": method, "metric": metric, "pair": pair}
            lines.append(line | _summary(metric, values))
    return pd.DataFrame(lines)


def make_tests(rows: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """Paired t-tests of the first method against each of the others.

    Args:
        rows: As in `make_cells`.

    Returns:
        A row for each other method and metric: `first`, `second`, `metric`, `count` of pairs, the two
        means, `difference`, `t`, `p`, `effect_size` (Cohen's d of the differences), and the `verdict`
        on the first one.

    Raises:
        ValueError: If the methods ran different episodes.
    """
    _check_same(rows)
    (first, mine), *others = rows.items()
    lines = []
    for second, theirs in others:
        for metric, a, b in _pairs(mine, theirs, _shown(rows)):
            test = paired_t_test(a, b)
            means = (values.mean() if len(values) else np.nan for values in (a, b))
            about: dict[str, Any] = {"first": first, "second": second, "metric": metric}
            about |= dict(zip(("first_mean", "second_mean"), means, strict=True))
            lines.append(about | vars(test) | {"verdict": against_method(metric, test)})
    return pd.DataFrame(lines)


def _shown(rows: Mapping[str, pd.DataFrame]) -> list[str]:
    frames = rows.values()
    return [name for name in SHOWN if all(name in f and f[name].notna().all() for f in frames)]


def _pairs(
    mine: pd.DataFrame, theirs: pd.DataFrame, metrics: Sequence[str]
) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """Each metric, and its values of two methods over the episodes that count for it."""
    solved = mine["success"].to_numpy(bool) & theirs["success"].to_numpy(bool)
    masks = {name: np.ones_like(solved) if name in OVER_ALL else solved for name in metrics}
    return [
        (name, mine.loc[mask, name].to_numpy(float), theirs.loc[mask, name].to_numpy(float))
        for name, mask in masks.items()
    ]


def _summary(metric: str, values: np.ndarray) -> dict[str, float]:
    count = len(values)
    if metric == "success":
        low, high = stats.binomtest(int(values.sum()), count).proportion_ci(method="wilson")
    else:
        low, high = bootstrap_interval(values)
    mean = float(values.mean()) if count else np.nan
    std = float(values.std(ddof=1)) if count > 1 else np.nan
    return {"count": count, "mean": mean, "low": float(low), "high": float(high), "std": std}


def _check_same(rows: Mapping[str, pd.DataFrame]) -> None:
    (first, reference), *others = rows.items()
    for method, frame in others:
        # Another version of a set has other starts, and so other shortest paths.
        same = len(frame) == len(reference) and all(
            np.allclose(frame[key], reference[key], atol=1e-4)
            for key in ("episode", "shortest_length")
        )
        if not same:
            raise ValueError(
                f"make_cells: methods must have run the same episodes, {first!r} has "
                f"{len(reference)} and {method!r} {len(frame)}, or others."
            )


def against_method(metric: str, test: PairedTest) -> Verdict:
    """Rule 1, for the first method of a paired test; "level" with fewer than two pairs."""
    return _signed(metric, test.difference) if test.significant(_LEVEL) else "level"


def against_printed(metric: str, cell: pd.Series, printed: float, runs: int) -> Verdict | None:
    """Rules 2 to 4, for one of our figures beside a printed one.

    Args:
        metric: Name of the paper's metric.
        cell: Our figure, with `mean`, `low`, `high` and `count`.
        printed: The printed figure.
        runs: Number of the paper's runs.

    Returns:
        The verdict; None where there is none by rule 4, or our figure is of no episodes.
    """
    count, mean = int(cell["count"]), float(cell["mean"])
    if metric == "path_length" or count < (1 if metric == "success" else _FEWEST):
        return None
    if metric == "success":
        ours, theirs = round(mean * count), round(printed * runs)
        table = [[ours, count - ours], [theirs, runs - theirs]]
        apart = stats.fisher_exact(table).pvalue < _LEVEL
    else:
        low, high = float(cell["low"]), float(cell["high"])
        if low == high:  # the rule of three
            low, high = mean - 3 / count * mean, mean + 3 / count * (1 - mean)
        apart = not low <= printed <= high
    return _signed(metric, mean - printed) if apart else "level"


def _signed(metric: str, difference: float) -> Verdict:
    better = difference < 0 if metric.startswith(_LOWER_IS_BETTER) else difference > 0
    return "ahead" if better else "behind"


def stands_for(metric: str, row: str, metrics: Sequence[str], evaluation_set: str) -> str:
    """Our column that is compared with a printed figure: measured as there, if the rows have it.

    Args:
        metric: The printed metric.
        row: Name of the printed row.
        metrics: Our columns.
        evaluation_set: The set.
    """
    as_there = measured_as(evaluation_set, of_controller=row == CONTROLLER)[metric]
    return as_there if as_there in metrics else metric


def judge(cells: pd.DataFrame, evaluation_set: str) -> pd.DataFrame:
    """Verdicts on all methods against the paper's rows of a set.

    An agent that was trained further with the set's object is judged against the paper's agent that was
    trained further, and the other agents against the paper's that was not. Where one of the two is
    missing, ours or the paper's, all are judged against every row.

    Args:
        cells: What `make_cells` returned.
        evaluation_set: The set; nothing is judged where the paper has no such set.

    Returns:
        A row for each method, printed row and metric: `method`, `versus`, `metric`, `ours` (our column),
        `mean`, `theirs`, `verdict`.
    """
    rows = printed_rows(evaluation_set)
    by_training = RETRAINED in set(cells["method"]) and len(rows) > 2
    lines = []
    for method, own in cells.groupby("method", sort=False):
        by_metric = own.set_index("metric")
        unlike = AGENT if method == RETRAINED else AGENT_RETRAINED
        for row in rows:
            for metric, printed in row.figures.items():
                ours = stands_for(metric, row.name, list(by_metric.index), evaluation_set)
                if (by_training and row.name == unlike) or ours not in by_metric.index:
                    continue
                cell = by_metric.loc[ours]
                verdict = against_printed(metric, cell, printed, row.episodes)
                if verdict is not None:
                    about = {"method": method, "versus": row.name, "metric": metric, "ours": ours}
                    figures = {"mean": cell["mean"], "theirs": printed}
                    lines.append({**about, **figures, "verdict": verdict})
    return pd.DataFrame(lines)
