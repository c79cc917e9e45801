"""Figures of several methods on one set, with intervals, and the tests between them."""

from collections.abc import Mapping

import numpy as np
import pandas as pd
from scipy import stats

from modpush.evaluation.stats import bootstrap_interval, paired_t_test
from modpush.reproduction.verdicts import LEVEL, against_method

__all__ = ["OVER_ALL", "SHOWN", "make_cells", "make_tests", "shown_metrics"]

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
"""Columns of the tables, of which those are shown that the rows have."""
OVER_ALL = ("success", "spl", "spl_authors_agent", "spl_authors_controller")
"""Metrics that are taken over all episodes; the others over those that both methods solved."""


def shown_metrics(rows: Mapping[str, pd.DataFrame]) -> list[str]:
    """The metrics of `SHOWN` that all rows have."""
    return [name for name in SHOWN if all(name in frame for frame in rows.values())]


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
        solved = frame["success"].to_numpy(bool) & rows[pair]["success"].to_numpy(bool)
        for metric in shown_metrics(rows):
            mask = np.ones_like(solved) if metric in OVER_ALL else solved
            values = frame.loc[mask, metric].to_numpy(dtype=float)
            line = {"method": method, "metric": metric, "pair": pair}
            lines.append(line | _summary(metric, values))
    return pd.DataFrame(lines)


def _summary(metric: str, values: np.ndarray) -> dict[str, float]:
    count = len(values)
    if metric == "success":
        interval = stats.binomtest(int(values.sum()), count).proportion_ci(method="wilson")
        low, high = float(interval.low), float(interval.high)
    else:
        low, high = bootstrap_interval(values)
    return {
        "count": count,
        "mean": float(values.mean()) if count else np.nan,
        "low": low,
        "high": high,
        "std": float(values.std(ddof=1)) if count > 1 else np.nan,
    }


def make_tests(rows: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """Paired t-tests of the first method against each of the others.

    Args:
        rows: As in `make_cells`.

    Returns:
        A row for each other method and metric: `first`, `second`, `metric`, `count` of pairs, the two
        means, `difference`, `t`, `p`, `effect_size` (Cohen's d of the differences), `verdict` for the
        first one.
    """
    _check_same(rows)
    (first, mine), *others = rows.items()
    lines = []
    for second, theirs in others:
        solved = mine["success"].to_numpy(bool) & theirs["success"].to_numpy(bool)
        for metric in shown_metrics(rows):
            mask = np.ones_like(solved) if metric in OVER_ALL else solved
            a, b = (frame.loc[mask, metric].to_numpy(dtype=float) for frame in (mine, theirs))
            test = paired_t_test(a, b)
            lines.append(
                {
                    "first": first,
                    "second": second,
                    "metric": metric,
                    "count": test.count,
                    "first_mean": a.mean() if len(a) else np.nan,
                    "second_mean": b.mean() if len(b) else np.nan,
                    "difference": test.difference,
                    "t": test.t,
                    "p": test.p,
                    "effect_size": test.effect_size,
                    "significant": test.significant(LEVEL),
                    "verdict": against_method(metric, test),
                }
            )
    return pd.DataFrame(lines)


def _check_same(rows: Mapping[str, pd.DataFrame]) -> None:
    (first, reference), *others = rows.items()
    for method, frame in others:
        if not np.array_equal(frame["episode"], reference["episode"]):
            raise ValueError(
                f"make_cells: methods must have run the same episodes, {first!r} has "
                f"{len(reference)} and {method!r} {len(frame)}."
            )
