"""Confidence intervals and tests over the episodes of a set."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from modpush._types import Count, Seed
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
