"""Tables of means, confidence intervals and paired tests from per-episode rows."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from modpush._types import Count, Fraction, Seed
from modpush._validation import checked_arguments


@checked_arguments
def bootstrap_interval(
    values: ArrayLike, confidence: float = 0.95, resamples: Count = 10_000, seed: Seed = 0
) -> tuple[float, float]:
    """Percentile bootstrap interval of the mean, by `scipy.stats.bootstrap`.

    Args:
        values: One value for each episode, `[N]`.
        confidence: Confidence level in (0, 1).
        resamples: Number of resamples.
        seed: Seed of the resampling; the same values always give the same interval.

    Returns:
        Lower and upper end; NaN without values. Where all values are equal both ends are that
        value, though of N successes in N episodes one can only say that the rate is above about
        1 - 3 / N.

    Raises:
        ValueError: If a number is out of range, or the values are not `[N]` and finite.
    """
    if not 0 < confidence < 1:
        raise ValueError(f"bootstrap_interval: confidence must be in (0, 1), got {confidence}.")
    sample = _checked_sample(values)
    if len(sample) == 0:
        return math.nan, math.nan
    if np.ptp(sample) == 0:  # scipy gives NaN
        return float(sample[0]), float(sample[0])
    interval = stats.bootstrap(
        (sample,),
        np.mean,
        confidence_level=confidence,
        n_resamples=resamples,
        method="percentile",
        batch=max(1, 1_000_000 // len(sample)),
        rng=np.random.default_rng(seed),
    ).confidence_interval
    return float(interval.low), float(interval.high)


@dataclass(frozen=True, kw_only=True)
class PairedTest:
    """Outcome of a two-sided paired t-test."""

    count: int
    """Number of pairs."""
    difference: float
    """Mean of the first minus the second method's values."""
    t: float
    """The test's statistic."""
    p: float
    """Probability of a difference at least this large if the means were equal."""
    effect_size: float
    """Cohen's d of the differences: their mean over their standard deviation."""

    def significant(self, level: float = 0.05) -> bool:
        """True if equal means are rejected at this level."""
        return self.p < level


def paired_t_test(first: ArrayLike, second: ArrayLike) -> PairedTest:
    """Paired t-test of two methods on the same episodes, by `scipy.stats.ttest_rel`.

    Args:
        first: Values of the first method, `[N]`.
        second: Values of the second method on the same episodes in the same order, `[N]`.

    Returns:
        The test. NaN with fewer than two pairs. Where all differences are the same, t and effect
        are 0 or infinite, and p is that of the sign test, which for values of 0 and 1 is McNemar's
        exact one.

    Raises:
        ValueError: If the shapes differ, or the values are not `[N]` and finite.
    """
    a, b = (_checked_sample(values) for values in (first, second))
    if a.shape != b.shape:
        raise ValueError(
            f"paired_t_test: first and second must be of one shape [N], got {a.shape} and {b.shape}."
        )
    n, nan = len(a), math.nan
    if n < 2:
        difference = float((a - b)[0]) if n else nan
        return PairedTest(count=n, difference=difference, t=nan, p=nan, effect_size=nan)
    mean, deviation = float(np.mean(a - b)), float(np.std(a - b, ddof=1))
    if deviation <= 1e-12 * max(1.0, abs(mean)):  # no spread but rounding: scipy gives NaN
        size = math.copysign(math.inf, mean) if abs(mean) > 1e-12 else 0.0
        p = 0.5 ** (n - 1) if size else 1.0
        return PairedTest(count=n, difference=mean, t=size, p=p, effect_size=size)
    t, p = map(float, stats.ttest_rel(a, b))
    return PairedTest(count=n, difference=mean, t=t, p=p, effect_size=mean / deviation)


def _checked_sample(values: ArrayLike) -> NDArray[np.float64]:
    sample = np.asarray(values, dtype=np.float64)
    if sample.ndim != 1 or not np.isfinite(sample).all():
        raise ValueError(f"values must be finite numbers [N], got {values!r}.")
    return sample


_OVER_ALL = ("success", "spl")
_WITHOUT_CONTACT = "success_without_contact"
_FURTHER = ("path_share", "effort", "objects_toppled", "objects_off", "side_changes")
_OVER_SOLVED = (
    "contact_rate",
    "contact_rate_at_end",
    "collision_rate",
    "collision_rate_object",
    "collision_rate_arm",
    "collision_rate_at_end",
    "path_length",
    "mean_jerk",
    "reversal_rate",
    "steps",
)
METRICS = (*_OVER_ALL, *(name for name in _OVER_SOLVED if name != "steps"))
"""Metrics that `compare` tests on every set. Success and SPL are over all episodes, the rest over solved
ones."""
LEGEND = (
    "`spl` is measured by the exact shortest path inside the workspace. `contact_rate` counts a step in "
    "which any of four looks shows contact, `contact_rate_at_end` one in which the look at its end does. "
    "`collision_rate` counts object, tool and arm by any of four looks, `collision_rate_object` and "
    "`collision_rate_arm` one of them alone, and `collision_rate_at_end` both by the look at the end.\n"
)
"""Meaning of the columns of a table of these metrics, in Markdown."""
_IDENTITY = ("episode", "scene", "pushed_object", "difficulty")


@checked_arguments
def summarize(rows: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """One line for each method, over the same episodes.

    Args:
        rows: Results of `evaluate`, by method.

    Returns:
        By method: `episodes`; `success` and `spl` with `_low` and `_high` of their 95 % bootstrap
        intervals, over all episodes, and on sets of goal poses `success_without_contact`, the share of
        episodes that succeeded and in which neither object, tool nor arm ever touched an obstacle, in
        the same way, and where there are such columns `path_share`, `effort`, `objects_toppled`,
        `objects_off` and `side_changes`; `solved`, the number of episodes that all methods solved, and
        over these alone the other metrics with their standard deviation, `_std` (NaN where there
        is none).

    Raises:
        ValueError: If the methods ran different episodes.
    """
    check_rows(rows)
    solved = _solved_by_all(rows)
    lines = []
    for method, frame in rows.items():
        line: dict[str, object] = {"method": method, "episodes": len(frame)}
        over_all = {name: frame[name] for name in _OVER_ALL}
        if "final_yaw_error" in frame:
            over_all[_WITHOUT_CONTACT] = frame["success"] & (frame["collision_rate"] == 0)
        over_all |= {name: frame[name] for name in _FURTHER if name in frame}
        for name, column in over_all.items():
            values = column.to_numpy(dtype=float)
            low, high = bootstrap_interval(values)
            line |= {name: values.mean(), f"{name}_low": low, f"{name}_high": high}
        line["solved"] = int(solved.sum())
        for name in _OVER_SOLVED:
            values = frame.loc[solved, name].to_numpy(dtype=float)
            line[name] = values.mean() if len(values) else np.nan
            line[f"{name}_std"] = values.std(ddof=1) if len(values) > 1 else np.nan
        lines.append(line)
    return pd.DataFrame(lines).set_index("method")


@checked_arguments
def compare(first: pd.DataFrame, second: pd.DataFrame, level: Fraction = 0.05) -> pd.DataFrame:
    """Paired t-tests between two methods over the same episodes.

    Success and SPL are paired over all episodes, and where both have such columns also `path_share`,
    `effort`, `objects_toppled`, `objects_off` and `side_changes`; the rest over those that both solved.

    Args:
        first: Result of `evaluate` for the first method.
        second: Result of `evaluate` for the second method.
        level: Significance level.

    Returns:
        By metric: `count` of pairs, `first` and `second` mean, `difference`, `t`, `p`,
        `effect_size` (Cohen's d of the differences), `significant`.

    Raises:
        TypeError: If one of them is not a data frame.
        ValueError: If the methods ran different episodes, or the level is not in [0, 1].
    """
    rows = {"first": first, "second": second}
    check_rows(rows)
    solved = _solved_by_all(rows)
    further = [name for name in _FURTHER if name in first and name in second]
    over_all = [*_OVER_ALL, *further]
    lines = []
    for name in (*over_all, *(name for name in METRICS if name not in _OVER_ALL)):
        mask = np.ones_like(solved) if name in over_all else solved
        a, b = (frame.loc[mask, name].to_numpy(dtype=float) for frame in (first, second))
        test = paired_t_test(a, b)
        lines.append(
            {
                "metric": name,
                "count": test.count,
                "first": a.mean() if len(a) else np.nan,
                "second": b.mean() if len(b) else np.nan,
                **asdict(test),
                "significant": test.significant(level),
            }
        )
    return pd.DataFrame(lines).set_index("metric")


def _solved_by_all(rows: Mapping[str, pd.DataFrame]) -> np.ndarray:
    return np.logical_and.reduce([frame["success"].to_numpy(bool) for frame in rows.values()])


def check_rows(rows: Mapping[str, pd.DataFrame]) -> None:
    """Raise a ValueError unless rows of episodes, by method, are whole and of the same episodes."""
    if not rows:
        raise ValueError("rows must be of at least one method, got none.")
    (first, reference), *others = rows.items()
    for method, frame in rows.items():
        if missing := sorted({*_OVER_ALL, *_OVER_SOLVED} - set(frame.columns)):
            raise ValueError(f"rows of {method!r} must have the columns {missing}, got none.")
        if not len(frame):
            raise ValueError(f"rows of {method!r} must be of one episode or more, got none.")
    for method, frame in others:
        same = len(frame) == len(reference) and all(
            np.array_equal(frame[key], reference[key]) for key in _IDENTITY if key in reference
        )
        if not same:
            raise ValueError(
                f"rows must be of methods that ran the same episodes in the same order, "
                f"{first!r} has {len(reference)} and {method!r} {len(frame)}."
            )


@checked_arguments
def to_display(summary: pd.DataFrame) -> pd.DataFrame:
    """A summary as text: means with their intervals or standard deviations.

    Args:
        summary: From `summarize`, or several concatenated.

    Returns:
        The same lines, one column for each metric.

    Raises:
        ValueError: If it is not a summary.
    """
    if missing := sorted({"episodes", "solved", *_OVER_ALL, *_OVER_SOLVED} - set(summary.columns)):
        raise ValueError(f"to_display: summary must have the columns {missing}, got none of them.")
    columns: dict[str, Sequence[str]] = {"episodes": [str(int(n)) for n in summary["episodes"]]}
    for name in (*_OVER_ALL, *(k for k in (_WITHOUT_CONTACT, *_FURTHER) if k in summary)):
        parts = zip(*(summary[key] for key in (name, f"{name}_low", f"{name}_high")), strict=True)
        columns[name] = [
            "–" if np.isnan(mean) else f"{mean:.3f} [{low:.3f}, {high:.3f}]"
            for mean, low, high in parts
        ]
    columns["solved"] = [str(int(n)) for n in summary["solved"]]
    for name in _OVER_SOLVED:
        digits = 1 if name == "steps" else 3
        pairs = zip(summary[name], summary[f"{name}_std"], strict=True)
        columns[name] = [
            "–" if np.isnan(mean) else f"{mean:.{digits}f} ± {std:.{digits}f}".replace("nan", "–")
            for mean, std in pairs
        ]
    return pd.DataFrame(columns, index=summary.index)


@checked_arguments
def format_table(table: pd.DataFrame) -> str:
    """A table in Markdown, its index as first columns.

    Args:
        table: Any table; fractions are written with three decimals.

    Raises:
        TypeError: If the table is not a data frame.
    """
    flat = table.reset_index()
    rows = [flat.columns, *flat.itertuples(index=False)]
    head, *body = (f"| {' | '.join(map(_cell, row))} |" for row in rows)
    return "\n".join([head, "|" + " --- |" * len(flat.columns), *body, ""])


def _cell(value: object) -> str:
    if isinstance(value, float | np.floating):
        return "–" if np.isnan(value) else f"{value:.3f}"
    return str(value).replace("|", r"\|")
