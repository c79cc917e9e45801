"""Costs of cells and the object's path by hand."""

import numpy as np
import torch

from modpush.agents.corridor.scene import corridor_cost, obstacle_distance
from tests.agents.corridor.corridor_scenes import plan, wall


def test_costs_by_hand():
    distance = torch.tensor([[[0.0, 2.0, 2.1, 5.0, 5.1, torch.inf]]])
    cost = corridor_cost(distance, torch.tensor([2.0]), torch.tensor([5.0]), (1.0, 50.0, 200.0))
    assert cost.tolist() == [[[200.0, 200.0, 50.0, 50.0, 1.0, 1.0]]]


def test_the_path_keeps_out_of_the_zones_where_it_can():
    path = plan(wall(), (5, 5), (5, 35))
    distance = obstacle_distance(wall())
    along = [distance[round(v), round(u)] for u, v in path]
    assert min(along) > 4.0  # equally spaced points lie between cells: one cell's slack
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    assert steps.max() < 1.3 * steps.mean()
    assert path[0].tolist() == [5, 5]
    assert path[-1].tolist() == [5, 35]


def test_a_blocked_path_is_the_straight_line():
    path = plan(wall(columns=slice(0, 60)), (5, 5), (5, 35), points=7)
    np.testing.assert_allclose(path[:, 0], 5)
    np.testing.assert_allclose(path[:, 1], np.linspace(5, 35, 7), atol=1e-4)
