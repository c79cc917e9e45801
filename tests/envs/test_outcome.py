import numpy as np
import pytest
import torch

from modpush.envs.outcome import is_at_goal, is_out_of_bounds
from modpush.envs.scenes.scenario import ScenarioConfig


@pytest.mark.parametrize("array", [np.array, torch.tensor])
def test_the_goal_is_reached_at_the_threshold(array) -> None:
    position = array([[0.53, 0.04], [0.5301, 0.04], [0.50, 0.0]])
    goal = array([[0.50, 0.0]] * 3)
    # A triangle of 3, 4 and 5 cm, a little more, and none.
    assert is_at_goal(position, goal, 0.05 + 1e-9).tolist() == [True, False, True]


@pytest.mark.parametrize("array", [np.array, torch.tensor])
def test_the_object_is_out_of_bounds_beyond_the_margin_on_each_side(array) -> None:
    inside = [[0.15, -0.40], [0.80, 0.40], [0.5, 0.0]]
    outside = [[0.149, 0.0], [0.801, 0.0], [0.5, -0.401], [0.5, 0.401]]
    bounds = ScenarioConfig().bounds(0.05 + 1e-9)  # of the workspace [0.20, 0.75] x [-0.35, 0.35]
    expected = [False] * 3 + [True] * 4
    assert is_out_of_bounds(array(inside + outside), bounds).tolist() == expected
