import math

import numpy as np
import pytest
from scipy import stats

from modpush.evaluation.tables import bootstrap_interval, paired_t_test


def test_bootstrap_agrees_with_the_normal_interval_on_many_values() -> None:
    # 900 successes of 1000: 0.9 +- 1.96 sqrt(0.9 * 0.1 / 1000) = 0.9 +- 0.0186
    values = np.repeat([1.0, 0.0], [900, 100])
    low, high = bootstrap_interval(values)
    assert low == pytest.approx(0.8814, abs=0.002)
    assert high == pytest.approx(0.9186, abs=0.002)


def test_bootstrap_repeats_itself_and_narrows_with_more_values() -> None:
    values = np.random.default_rng(1).normal(size=400)
    low, high = bootstrap_interval(values)
    assert (low, high) == bootstrap_interval(values)
    few = bootstrap_interval(values[:100])
    assert high - low < few[1] - few[0]


def test_paired_t_test_by_hand() -> None:
    # differences 1, 2, 3: mean 2, sd 1, t = 2 / (1 / sqrt 3) = 3.4641, d = 2
    test = paired_t_test([2.0, 4.0, 6.0], [1.0, 2.0, 3.0])
    assert test.difference == pytest.approx(2.0)
    assert test.t == pytest.approx(3.4641, abs=1e-4)
    assert test.effect_size == pytest.approx(2.0)
    assert test.p == pytest.approx(2 * stats.t.sf(3.4641016, 2), rel=1e-6)
    assert not test.significant()  # p = 0.074
    assert test.significant(0.1)


def test_paired_t_test_without_spread() -> None:
    same = paired_t_test([1.0, 0.0, 1.0], [1.0, 0.0, 1.0])
    assert (same.t, same.p, same.effect_size) == (0.0, 1.0, 0.0)
    shifted = paired_t_test([1.5, 2.5], [1.0, 2.0])
    assert (shifted.t, shifted.p) == (math.inf, 0.5)
    lower = paired_t_test([1.0, 2.0], [1.5, 2.5])
    assert (lower.difference, lower.t, lower.effect_size) == (-0.5, -math.inf, -math.inf)
    for count in (2, 5, 6, 40):  # episodes that one method alone solves
        alone = paired_t_test([1.0] * count, [0.0] * count)
        assert alone.p == pytest.approx(stats.binomtest(count, count).pvalue)
        assert alone.significant() == (count >= 6)
    assert math.isnan(paired_t_test([1.0], [2.0]).p)
    assert not paired_t_test([], []).significant()
