"""The rules by which a figure is ahead, level or behind, on figures made by hand."""

import math

import numpy as np
import pandas as pd
import pytest

from modpush.evaluation.stats import paired_t_test
from modpush.reproduction import against_method, against_printed
from modpush.reproduction.companion import verdict_lists


def cell(mean: float, low: float, high: float, count: int = 1000) -> pd.Series:
    return pd.Series({"mean": mean, "low": low, "high": high, "count": count})


def test_against_a_method_the_paired_test_and_the_sign_decide() -> None:
    better = paired_t_test([1.0, 0.9, 1.0, 0.8], [0.1, 0.2, 0.0, 0.0])  # t = 11.5
    worse = paired_t_test([0.1, 0.2, 0.0, 0.0], [1.0, 0.9, 1.0, 0.8])
    unclear = paired_t_test([1.0, 0.0, 1.0, 0.0], [0.0, 1.0, 0.0, 0.9])  # t = 0.04
    assert against_method("success", better) == "ahead"
    assert against_method("success", worse) == "behind"
    assert against_method("collision_rate", better) == "behind"  # less is better
    assert against_method("path_length", worse) == "ahead"
    assert against_method("spl", unclear) == "level"
    assert against_method("spl", paired_t_test([1.0], [0.0])) == "level"  # one pair proves nothing


def test_against_a_printed_success_rate_fisher_s_test_decides() -> None:
    # 980 of 1000 beside 955 of 1000: p = 0.002; 975 beside 977: p = 0.88
    assert against_printed("success", cell(0.98, 0, 1), 0.955, 1000) == "ahead"
    assert against_printed("success", cell(0.955, 0, 1), 0.980, 1000) == "behind"
    assert against_printed("success", cell(0.975, 0, 1), 0.977, 1000) == "level"
    # 39 of 50 beside 44 of 50: p = 0.29, however far apart
    assert against_printed("success", cell(0.78, 0.65, 0.87, 50), 0.88, 50) == "level"
    # 500 of 500 beside 499 of 500: p = 1
    assert against_printed("success", cell(1.0, 1.0, 1.0, 500), 0.998, 500) == "level"


def test_against_another_printed_figure_the_interval_decides() -> None:
    assert against_printed("spl", cell(0.93, 0.92, 0.94), 0.91, 1000) == "ahead"
    assert against_printed("spl", cell(0.93, 0.92, 0.94), 0.94, 1000) == "level"
    assert against_printed("contact_rate", cell(0.93, 0.92, 0.94), 0.95, 1000) == "behind"
    assert against_printed("collision_rate", cell(0.004, 0.002, 0.006), 0.008, 1000) == "ahead"
    assert against_printed("collision_rate", cell(0.020, 0.015, 0.025), 0.008, 1000) == "behind"
    assert against_printed("path_length", cell(0.5, 0.4, 0.6), 0.9, 1000) is None


def test_few_episodes_prove_nothing_against_a_printed_figure() -> None:
    nine = cell(0.9, 0.89, 0.91, 29)
    assert against_printed("contact_rate", nine, 0.5, 1000) is None
    assert against_printed("success", nine, 0.2, 1000) == "ahead"  # by a test that counts episodes
    # No collision in any of 30 or 1000 episodes: by the rule of three up to 0.1 and 0.003.
    none = cell(0.0, 0.0, 0.0, 30)
    assert against_printed("collision_rate", none, 0.065, 1000) == "level"
    assert against_printed("collision_rate", none, 0.2, 1000) == "ahead"
    assert against_printed("collision_rate", cell(0.0, 0.0, 0.0), 0.008, 1000) == "ahead"
    assert against_printed("contact_rate", cell(1.0, 1.0, 1.0), 0.998, 1000) == "level"
    assert against_printed("contact_rate", cell(1.0, 1.0, 1.0), 0.990, 1000) == "ahead"


def test_the_lists_hold_every_verdict_on_an_agent_once() -> None:
    about = {"table": "free", "section": "Small cube", "set": "free/small_cube"}
    base = {**about, "low": 0.0, "high": 1.0}
    lines = [
        ("agent", "paper: agent", "success", 0.98, 0.95, "ahead"),
        ("agent", "paper: agent", "spl", 0.90, 0.91, "level"),
        ("agent", "paper: controller", "spl", 0.90, 0.95, "behind"),
        ("corridor", "paper: controller", "spl", 0.90, 0.95, "behind"),
    ]
    names = ["method", "versus", "ours", "mean", "theirs", "verdict"]
    verdicts = pd.DataFrame([{**base, **dict(zip(names, line, strict=True))} for line in lines])
    text = "\n\n".join(verdict_lists(verdicts.assign(metric=verdicts["ours"])))
    assert "| paper: agent | 1 | 1 | 0 |" in text
    assert "| paper: controller | 0 | 0 | 1 |" in text  # the controller's own row is not counted
    ahead, behind = text.split("### Level")[0], text.split("### Behind")[1]
    assert "free, Small cube, agent against paper: agent: success 0.980 (0.950)" in ahead
    assert behind.strip() == (
        "- free, Small cube, agent against paper: controller: spl 0.900 (0.950)"
    )
    assert verdict_lists(verdicts[:1].assign(metric="success"))[-1] == "Nothing."


def test_no_interval_leaves_a_verdict_level() -> None:
    nothing = cell(math.nan, math.nan, math.nan, 0)
    with pytest.raises(ValueError, match="of one episode or more, got contact_rate of none"):
        against_printed("contact_rate", nothing, 0.9, 1000)
    assert against_printed("contact_rate", cell(*np.full(3, 0.9)), 0.9, 1000) == "level"
