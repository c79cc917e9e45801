"""A* against scipy's optimum on the same neighbourhood."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings, strategies as st
from planner_maps import solvable_maps
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from modpush.planners import AStar


def cell_graph(blocked, neighbours, weight=None):
    """Graph of free cells; diagonal steps need both cells beside them free."""
    height, width = blocked.shape
    number = np.arange(blocked.size).reshape(blocked.shape)
    weight = np.ones(blocked.shape) if weight is None else weight
    rows, columns, costs = [], [], []
    steps = [(0, 1), (1, 0)] + ([(1, 1), (1, -1)] if neighbours == 8 else [])
    for dy, dx in steps:
        a = (slice(0, height - dy), slice(max(0, -dx), width - max(0, dx)))
        b = (slice(dy, height), slice(max(0, dx), width + min(0, dx)))
        free = ~blocked[a] & ~blocked[b]
        if dx and dy:
            free &= ~blocked[a[0], b[1]] & ~blocked[b[0], a[1]]
        rows.append(number[a][free])
        columns.append(number[b][free])
        costs.append((np.hypot(dx, dy) * 0.5 * (weight[a] + weight[b]))[free])
    data = (np.concatenate(costs), (np.concatenate(rows), np.concatenate(columns)))
    return coo_matrix(data, shape=(blocked.size, blocked.size)).tocsr()


def optimum(blocked, start, goal, neighbours, weight=None):
    width = blocked.shape[1]
    graph = cell_graph(blocked, neighbours, weight)
    source = int(start[1]) * width + int(start[0])
    return dijkstra(graph, directed=False, indices=source)[int(goal[1]) * width + int(goal[0])]


def tensors(blocked, start, goal):
    return (
        torch.from_numpy(blocked)[None],
        torch.tensor(np.array(start, np.float32))[None],
        torch.tensor(np.array(goal, np.float32))[None],
    )


@pytest.mark.parametrize("neighbours", [4, 8])
def test_equals_scipy_s_dijkstra(neighbours):
    planner = AStar(neighbours=neighbours)
    for blocked, start, goal in solvable_maps(21, 8):
        length = planner.plan(*tensors(blocked, start, goal)).length.item()
        assert length == pytest.approx(optimum(blocked, start, goal, neighbours), rel=1e-6)


@settings(max_examples=80, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([4, 8]))
def test_small_maps_with_weights(seed, neighbours):
    rng = np.random.default_rng(seed)
    blocked = rng.random(rng.integers(2, 12, 2)) < rng.uniform(0, 0.5)
    blocked[0, 0] = blocked[-1, -1] = False
    weight = rng.choice([1.0, 50.0, 200.0], blocked.shape).astype(np.float32)
    start, goal = (0, 0), (blocked.shape[1] - 1, blocked.shape[0] - 1)
    planner = AStar(neighbours=neighbours)
    expected = optimum(blocked, start, goal, neighbours)
    assert planner.plan(*tensors(blocked, start, goal)).length.item() == pytest.approx(expected)

    best = optimum(blocked, start, goal, neighbours, weight)
    paths = planner.plan_weighted(
        torch.from_numpy(blocked)[None],
        torch.from_numpy(weight)[None],
        *tensors(blocked, start, goal)[1:],
    )
    assert paths.found.item() == np.isfinite(best)
    if paths.found:
        assert cost_along(paths.waypoints[0, : paths.count[0]].numpy(), weight) == pytest.approx(
            best
        )


def cost_along(points, weight):
    """Cost of a path given by the cells at which it turns."""
    total = 0.0
    for a, b in zip(points[:-1].astype(int), points[1:].astype(int), strict=True):
        steps = np.abs(b - a).max()
        cells = a + np.outer(np.arange(steps + 1), np.sign(b - a))
        along = weight[cells[:, 1], cells[:, 0]].astype(float)
        total += np.hypot(*np.sign(b - a)) * (0.5 * (along[:-1] + along[1:])).sum()
    return total


def test_ends_off_the_cells_centres_are_joined_to_them():
    # Cells (0, 0) to (3, 0): 3 px between centres become legs from (0.2, 0.1) to (1, 0), on to
    # (2, 0) and on to (3.4, 0.3); waypoints only where the path turns.
    blocked = np.zeros((1, 4), bool)
    paths = AStar().plan(*tensors(blocked, (0.2, 0.1), (3.4, 0.3)))
    assert paths.waypoints[0, 0].tolist() == pytest.approx([0.2, 0.1])
    assert paths.waypoints[0, -1].tolist() == pytest.approx([3.4, 0.3])
    assert 3.2 < paths.length.item() < 3.3


def test_start_and_goal_in_one_cell():
    blocked = np.zeros((3, 3), bool)
    paths = AStar().plan(*tensors(blocked, (0.8, 1.0), (1.2, 1.0)))
    assert paths.found.item()
    assert paths.length.item() == pytest.approx(0.4)
    assert paths.count.item() == 2
