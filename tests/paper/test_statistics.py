"""Figures, tests and verdicts from rows made by hand."""

import math
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from modpush.evaluation.sets import EVALUATION_SETS
from paper.published import PAPER, printed_rows
from paper.statistics import (
    against_printed,
    judge,
    make_cells,
    make_tests,
)


def rows(success: list[int], contact: list[float], path: list[float]) -> pd.DataFrame:
    return pd.DataFrame(
        {
            "episode": range(len(success)),
            "scene": "slot",
            "success": np.array(success, dtype=bool),
            "spl": np.array(success) * 0.5,
            "contact_rate": contact,
            "collision_rate": 0.0,
            "path_length": path,
            "shortest_length": 0.4,
        }
    )


AGENT = rows([1, 1, 1, 0], [0.8, 0.6, 0.1, 0.0], [0.4, 0.6, 9.0, 9.0])
CORRIDOR = rows([1, 1, 0, 1], [0.4, 0.4, 0.0, 0.2], [0.4, 0.5, 9.0, 9.0])
FAITHFUL = rows([1, 0, 1, 0], [0.2, 0.0, 0.3, 0.0], [0.4, 9.0, 0.8, 9.0])
ROWS = {"mine": AGENT, "corridor": CORRIDOR, "corridor_faithful": FAITHFUL}


def as_there(frame: pd.DataFrame) -> pd.DataFrame:
    """Fifteen times the same, with what is measured as in the paper: more than 30 count for a mean."""
    return pd.concat([frame] * 15, ignore_index=True).assign(
        spl_authors_agent=0.4,
        spl_authors_controller=0.6,
        contact_rate_at_end=0.1,
        collision_rate_at_end=0.2,
        collision_rate_object_at_end=0.1,
    )


def test_a_cell_is_over_what_both_methods_of_its_pair_solved() -> None:
    cells = make_cells(ROWS).set_index(["method", "metric"])
    # The agent and the corridor solved 0 and 1, the agent and the faithful one 0 and 2.
    assert cells.loc[("mine", "contact_rate"), "mean"] == pytest.approx(0.7)
    assert cells.loc[("corridor", "contact_rate"), "mean"] == pytest.approx(0.4)
    assert cells.loc[("corridor_faithful", "contact_rate"), "mean"] == pytest.approx(0.25)
    assert cells.loc[("mine", "contact_rate"), "std"] == pytest.approx(np.sqrt(0.02))
    pairs = {"mine": "corridor", "corridor": "mine", "corridor_faithful": "mine"}
    assert cells["pair"].groupby("method").first().to_dict() == pairs
    success = cells.loc[("mine", "success")]
    assert (success["mean"], success["count"]) == (0.75, 4)
    # Wilson's interval of 3 in 4, by its formula: (p + z²/2n ± z sqrt(p(1-p)/n + z²/4n²)) / (1 + z²/n)
    assert (success["low"], success["high"]) == pytest.approx((0.3006, 0.9544), abs=1e-4)


def test_the_tests_are_those_of_scipy_over_the_pair() -> None:
    tests = make_tests(ROWS).set_index(["second", "metric"])
    contact = tests.loc[("corridor", "contact_rate")]
    assert contact["p"] == pytest.approx(stats.ttest_rel([0.8, 0.6], [0.4, 0.4]).pvalue)
    assert contact["effect_size"] == pytest.approx(2.1213, abs=1e-4)  # 0.3 / 0.1414
    assert contact["count"] == 2
    assert tests.loc[("corridor_faithful", "success"), "count"] == 4
    assert set(tests["verdict"]) == {"level"}


@pytest.mark.parametrize("other", [CORRIDOR.head(3), CORRIDOR.assign(shortest_length=0.5)])
def test_methods_are_compared_on_the_same_episodes_only(other: pd.DataFrame) -> None:
    with pytest.raises(ValueError, match="'mine' has 4 and 'corridor'"):
        make_tests({"mine": AGENT, "corridor": other})


@pytest.mark.parametrize(
    ("metric", "cell", "printed", "runs", "verdict"),
    [
        # Fisher's test. 980 of 1000 beside 955 of 1000: p = 0.002; 975 beside 977: p = 0.88
        ("success", (0.98, 0, 1, 1000), 0.955, 1000, "ahead"),
        ("success", (0.955, 0, 1, 1000), 0.980, 1000, "behind"),
        ("success", (0.975, 0, 1, 1000), 0.977, 1000, "level"),
        # 39 of 50 beside 44 of 50: p = 0.29, however far apart; 26 of 29 beside 200 of 1000
        ("success", (0.78, 0.65, 0.87, 50), 0.88, 50, "level"),
        ("success", (0.9, 0.89, 0.91, 29), 0.2, 1000, "ahead"),
        # The interval of our mean.
        ("spl", (0.93, 0.92, 0.94, 1000), 0.91, 1000, "ahead"),
        ("spl", (0.93, 0.92, 0.94, 1000), 0.94, 1000, "level"),
        ("contact_rate", (0.93, 0.92, 0.94, 1000), 0.95, 1000, "behind"),
        ("collision_rate", (0.004, 0.002, 0.006, 1000), 0.008, 1000, "ahead"),
        ("collision_rate", (0.020, 0.015, 0.025, 1000), 0.008, 1000, "behind"),
        # No collision in any of 30 or 1000 episodes: by the rule of three up to 0.1 and 0.003.
        ("collision_rate", (0.0, 0.0, 0.0, 30), 0.065, 1000, "level"),
        ("collision_rate", (0.0, 0.0, 0.0, 30), 0.2, 1000, "ahead"),
        ("contact_rate", (1.0, 1.0, 1.0, 1000), 0.990, 1000, "ahead"),
        # Not judged: path lengths, and means of few or no episodes.
        ("path_length", (0.5, 0.4, 0.6, 1000), 0.9, 1000, None),
        ("contact_rate", (0.9, 0.89, 0.91, 29), 0.5, 1000, None),
        ("contact_rate", (math.nan, math.nan, math.nan, 0), 0.9, 1000, None),
    ],
)
def test_the_rules_beside_a_printed_figure(
    metric: str, cell: tuple[float, ...], printed: float, runs: int, verdict: Any
) -> None:
    figure = pd.Series(cell, ["mean", "low", "high", "count"])
    assert against_printed(metric, figure, printed, runs) == verdict


def test_printed_figures_stand_beside_what_is_measured_as_there() -> None:
    cells = make_cells({name: as_there(frame) for name, frame in ROWS.items()})
    judged = judge(cells, "obstacles/fragment")
    paper = {"paper: agent", "paper: controller", "paper: agent, retrained"}
    assert set(judged["versus"]) == paper
    ours = judged[judged["method"] == "mine"].set_index(["versus", "metric"])["ours"]
    assert ours["paper: agent"].to_dict() == {
        "success": "success",
        "contact_rate": "contact_rate_at_end",
        "collision_rate": "collision_rate_object_at_end",
        "spl": "spl_authors_agent",
    }
    assert ours[("paper: controller", "spl")] == "spl_authors_controller"
    assert ours[("paper: controller", "collision_rate")] == "collision_rate_at_end"
    # In free space the authors measured both methods by Lazy Theta*, whatever the tool's start.
    free = judge(cells, "behind/free/small_cube").set_index(["method", "versus", "metric"])
    assert free.loc[("mine", "paper: controller", "spl"), "ours"] == "spl_authors_agent"
    assert judge(cells, "hard_wide/small_cube").empty
    # Rows of an early version lack these columns; ours of the same name stands in.
    assert set(judge(make_cells(ROWS), "obstacles/fragment")["metric"]) == {"success"}


def test_the_paper_s_figures_are_those_of_its_sets() -> None:
    assert set(PAPER) == set(EVALUATION_SETS) - {"hard_wide/small_cube"}
    for row in (row for rows in PAPER.values() for row in rows):
        assert set(row.figures) == {*row.stds, "success", "spl"}
        assert all(0.5 <= row.figures[name] <= 1 for name in ("success", "spl", "contact_rate"))
    retrained = printed_rows("obstacles/fragment")[2]
    assert list(retrained.figures.values()) == [0.959, 0.984, 0.01, 0.83, 0.58]
    assert retrained.stds == {"contact_rate": 0.05, "collision_rate": 0.05, "path_length": 0.23}
    assert printed_rows("behind/hard200/small_cube")[1].episodes == 50
