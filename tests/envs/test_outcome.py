import numpy as np
import pytest

from modpush.envs.outcome import episode_status, is_at_goal, is_out_of_bounds
from modpush.envs.scenes.scenario import ScenarioConfig


def test_the_goal_is_reached_at_the_threshold() -> None:
    position = np.array([[0.53, 0.04], [0.5301, 0.04], [0.50, 0.0]])
    goal = np.array([[0.50, 0.0]] * 3)
    # A triangle of 3, 4 and 5 cm, a little more, and none.
    assert is_at_goal(position, goal, 0.05 + 1e-9).tolist() == [True, False, True]


def test_the_object_is_out_of_bounds_beyond_the_margin_on_each_side() -> None:
    inside = [[0.15, -0.40], [0.80, 0.40], [0.5, 0.0]]
    outside = [[0.149, 0.0], [0.801, 0.0], [0.5, -0.401], [0.5, 0.401]]
    bounds = ScenarioConfig().bounds(0.05 + 1e-9)  # of the workspace [0.20, 0.75] x [-0.35, 0.35]
    expected = [False] * 3 + [True] * 4
    assert is_out_of_bounds(np.array(inside + outside), bounds).tolist() == expected


@pytest.mark.parametrize("oob", ["truncate", "terminate"])
def test_how_an_episode_ends(oob) -> None:
    # At the goal; out of bounds; at the step limit; going on; at the goal and at the limit.
    position = np.array([[0.5, 0.0], [0.9, 0.0], [0.3, 0.0], [0.3, 0.0], [0.5, 0.0]])
    success = np.array([True, False, False, False, True])
    steps = np.array([1, 1, 7, 6, 7])
    status = episode_status(success, position, ScenarioConfig().bounds(), steps, 7, oob)
    assert status.success.tolist() == [True, False, False, False, True]
    assert status.out_of_bounds.tolist() == [False, True, False, False, False]
    assert status.terminated.tolist() == [True, oob == "terminate", False, False, True]
    assert status.truncated.tolist() == [False, True, True, False, True]
    assert status.done.tolist() == [True, True, True, False, True]
    unlimited = episode_status(success, position, ScenarioConfig().bounds(), steps, None, oob)
    assert unlimited.truncated.tolist() == [False, True, False, False, False]
