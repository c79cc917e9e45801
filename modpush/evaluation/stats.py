"""Intervals and tests over a set of episodes."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

__all__ = ["PairedTest", "bootstrap_interval", "paired_t_test"]


def bootstrap_interval(
    values: ArrayLike, confidence: float = 0.95, resamples: int = 10_000, seed: int = 0
) -> tuple[float, float]:
    """Percentile bootstrap interval of the mean.

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
        ValueError: If `confidence` is out of range.
    """
    if not 0 < confidence < 1:
        raise ValueError(f"bootstrap_interval: confidence must be in (0, 1), got {confidence}.")
    sample = np.asarray(values, dtype=np.float64)
    if len(sample) == 0:
        return math.nan, math.nan
    if np.ptp(sample) == 0:
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
        """Whether equal means are rejected at this level."""
        return self.p < level


def paired_t_test(first: ArrayLike, second: ArrayLike) -> PairedTest:
    """A paired t-test of two methods on the same episodes.

    Args:
        first: Values of the first method, `[N]`.
        second: Values of the second method on the same episodes in the same order, `[N]`.

    Returns:
        The test. NaN with fewer than two pairs. Where all differences are the same, t and effect
        are 0 or infinite.

    Raises:
        ValueError: If the shapes differ.
    """
    a, b = np.asarray(first, dtype=np.float64), np.asarray(second, dtype=np.float64)
    if a.shape != b.shape or a.ndim != 1:
        raise ValueError(
            f"paired_t_test: expected two arrays of one shape [N], got {a.shape} and {b.shape}."
        )
    n = len(a)
    mean = float(np.mean(a - b)) if n else math.nan
    if n < 2:
        return PairedTest(count=n, difference=mean, t=math.nan, p=math.nan, effect_size=math.nan)
    deviation = float(np.std(a - b, ddof=1))
    if deviation <= 1e-12 * max(1.0, abs(mean)):  # no spread but rounding
        size = math.copysign(math.inf, mean) if abs(mean) > 1e-12 else 0.0
        p = 0.0 if size else 1.0
        return PairedTest(count=n, difference=mean, t=size, p=p, effect_size=size)
    test = stats.ttest_rel(a, b)
    return PairedTest(
        count=n,
        difference=mean,
        t=float(test.statistic),
        p=float(test.pvalue),
        effect_size=mean / deviation,
    )
