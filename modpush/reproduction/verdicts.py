"""Whether a figure is ahead of another one, level with it or behind it, by the rules in `RULES`."""

from typing import Literal

import pandas as pd
from scipy import stats

from modpush._arguments import checked_arguments
from modpush._types import Finite, NonNegativeInteger
from modpush.evaluation.stats import PairedTest

__all__ = ["LOWER_IS_BETTER", "RULES", "Verdict", "against_method", "against_printed"]

Verdict = Literal["ahead", "level", "behind"]
LEVEL = 0.05
"""Significance level of all tests."""
_FEWEST = 30
"""Number of episodes from which on a mean is judged against a printed one: bootstrapped intervals of
fewer are too narrow, most of all where nearly all values are 0 or 1."""
LOWER_IS_BETTER = ("collision_rate", "path_length", "mean_jerk", "reversal_rate")
"""Metrics of which less is better; of all others more is."""
RULES = f"""
1. Against a method that was measured here on the same episodes: ahead or behind where the two-sided
   paired t-test rejects equal means at 0.05, else level.
2. Against a printed success rate: ahead or behind where Fisher's exact test of the numbers of
   successes, ours and those that the printed rate stands for, gives p < 0.05, else level.
3. Against another printed figure: ahead or behind where the 95 % interval of our mean leaves it out,
   else level. The printed figure's own uncertainty is not known, so that these verdicts are a little
   bolder than tests would be. Where all our values are equal, the interval is
   that of the rule of three: of n values 3 more could have been 0 or 1.
4. Path lengths are not judged against printed ones: they depend on the episodes that were drawn. Nor
   are means over fewer than {_FEWEST} episodes, but for success rates.
"""
"""The rules in Markdown, as the companion page prints them."""


@checked_arguments
def against_method(metric: str, test: PairedTest) -> Verdict:
    """Rule 1, for the first method of a paired test.

    Args:
        metric: Name of the metric.
        test: The test; with fewer than two pairs, or NaN for p, the verdict is "level".
    """
    return _signed(metric, test.difference) if test.significant(LEVEL) else "level"


@checked_arguments
def against_printed(
    metric: str, cell: pd.Series, printed: Finite, printed_runs: NonNegativeInteger
) -> Verdict | None:
    """Rules 2 to 4, for one of our figures beside a printed one.

    Args:
        metric: Name of the paper's metric.
        cell: Our figure, with `mean`, `low`, `high` and `count`.
        printed: The printed figure.
        printed_runs: Number of the paper's runs.

    Returns:
        The verdict; None where there is none by rule 4.

    Raises:
        ValueError: If our figure is of no episodes, or lacks something.
    """
    if missing := sorted({"mean", "low", "high", "count"} - set(cell.index)):
        raise ValueError(f"against_printed: cell must have {missing}, got {sorted(cell.index)}.")
    if metric == "path_length":
        return None
    if not cell["count"]:
        raise ValueError(
            f"against_printed: cell must be of one episode or more, got {metric} of none."
        )
    difference = float(cell["mean"]) - printed
    if metric == "success":
        count = int(cell["count"])
        ours, theirs = round(float(cell["mean"]) * count), round(printed * printed_runs)
        table = [[ours, count - ours], [theirs, printed_runs - theirs]]
        apart = stats.fisher_exact(table).pvalue < LEVEL
    elif cell["count"] < _FEWEST:
        return None
    else:
        low, high = _interval(cell)
        apart = not low <= printed <= high
    return _signed(metric, difference) if apart else "level"


def _interval(cell: pd.Series) -> tuple[float, float]:
    """A figure's interval; where all values are the same, by the rule of three."""
    mean, low, high = float(cell["mean"]), float(cell["low"]), float(cell["high"])
    if low == high:
        share = 3 / float(cell["count"])
        return mean - share * mean, mean + share * (1 - mean)
    return low, high


def _signed(metric: str, difference: float) -> Verdict:
    better = difference < 0 if metric.startswith(LOWER_IS_BETTER) else difference > 0
    return "ahead" if better else "behind"
