"""Paths through obstacles that can be pushed away."""

import itertools

import networkx as nx
import numpy as np
import pytest
import torch

from modpush.geometry.camera import Camera
from modpush.geometry.workspace import Rectangle
from modpush.planners import ThroughObstacles

CAMERA = Camera(height=64, width=80)
FREE = torch.zeros(1, 64, 80, dtype=torch.bool)
START, GOAL = torch.tensor([[9.5, 33.5]]), torch.tensor([[69.5, 33.5]])  # centres of cells


def plan(occupancy: torch.Tensor, **options) -> tuple[np.ndarray, float]:
    """Waypoints `[P, 2]` and length of the one path."""
    paths = ThroughObstacles(camera=CAMERA, **options).plan(occupancy, START, GOAL)
    assert bool(paths.found.all())
    return paths.waypoints[0, : int(paths.count[0])].numpy(), float(paths.length[0])


def cheapest(occupancy: np.ndarray, weight: float) -> float:
    """Cost of the cheapest way over cells of 4 pixels in 8 directions, by networkx."""
    cost = 1 + (weight - 1) * occupancy.reshape(16, 4, 20, 4).mean((1, 3))
    graph = nx.Graph()
    for (down, right), i, j in itertools.product(
        ((0, 1), (1, 0), (1, 1), (1, -1)), range(16), range(20)
    ):
        if i + down < 16 and 0 <= j + right < 20:
            mean = (cost[i, j] + cost[i + down, j + right]) / 2
            graph.add_edge((i, j), (i + down, j + right), weight=4 * np.hypot(down, right) * mean)
    return float(nx.dijkstra_path_length(graph, (8, 2), (8, 17)))


def cost_along(points: np.ndarray, occupancy: np.ndarray, weight: float) -> float:
    """Cost of a path of straight legs, over the same cells of 4 pixels."""
    cost = 1 + (weight - 1) * occupancy.reshape(16, 4, 20, 4).mean((1, 3))
    total = 0.0
    for a, b in itertools.pairwise(points):
        length = float(np.linalg.norm(b - a))
        t = np.linspace(0, 1, max(2, int(20 * length)))[:, None]
        u, v = ((a + t * (b - a) + 0.5) // 4).astype(int).T
        total += length * float(cost[v, u].mean())
    return total


def test_nothing_in_the_way_is_a_straight_line():
    points, length = plan(FREE)
    assert points == pytest.approx(np.array([[9.5, 33.5], [69.5, 33.5]]))
    assert length == pytest.approx(60.0)


@pytest.mark.parametrize(("height", "through"), [(12, False), (64, True)])
def test_it_goes_around_what_is_short_and_through_what_is_not(height, through):
    wall = FREE.clone()
    wall[:, 32 - height // 2 : 32 + height // 2, 36:40] = True
    points, _ = plan(wall, weight=8.0)
    assert (len(points) == 2) == through
    free = cost_along(points, wall[0].numpy(), 1.0)
    assert (cost_along(points, wall[0].numpy(), 8.0) == pytest.approx(free)) != through


def test_paths_cost_what_networkx_finds():
    rng = np.random.default_rng(0)
    for weight in (1.5, 2.0, 6.0):
        for _ in range(5):
            cells = np.zeros((16, 20), dtype=bool)
            for row, column in zip(rng.integers(0, 14, 5), rng.integers(4, 14, 5), strict=True):
                cells[row : row + 3, column : column + 3] = True
            occupancy = torch.from_numpy(np.kron(cells, np.ones((4, 4), bool)))[None]
            points, _ = plan(occupancy, weight=weight)
            best = cheapest(occupancy[0].numpy(), weight)
            assert 0.9 * best <= cost_along(points, occupancy[0].numpy(), weight) <= 1.03 * best


def test_it_stays_off_the_edge_of_the_workspace():
    gate = FREE.clone()  # whose only opening lies at the edge
    gate[:, 24:, 36:40] = True
    low, high = np.sort(CAMERA.unproject(torch.tensor([[0.0, 63.0], [79.0, 16.0]])).numpy(), 0)
    bounds = Rectangle(tuple(low.tolist()), tuple(high.tolist()))
    around, _ = plan(gate, weight=20.0, bounds=bounds, edge=0.0)
    through, _ = plan(gate, weight=20.0, bounds=bounds, edge=12 * CAMERA.cell_size)
    assert around[:, 1].min() < 24
    assert through[:, 1].min() > 27


def test_a_map_that_changes_is_searched_anew():
    planner, wall = ThroughObstacles(weight=8.0), FREE.clone()
    wall[:, 26:38, 36:40] = True
    lengths = [float(planner.plan(m, START, GOAL).length) for m in (FREE, wall, wall, FREE)]
    assert lengths[0] == lengths[3] < lengths[1] == lengths[2]


@pytest.mark.parametrize("end", [(-5.0, 200.0), (79.5, 0.0)])
def test_ends_outside_the_image_or_in_obstacles(end):
    blocked = torch.ones_like(FREE)
    goal = torch.tensor([end])
    paths = ThroughObstacles().plan(blocked, START, goal)
    assert paths.waypoints[0, int(paths.count[0]) - 1].tolist() == list(end)


def test_wrong_arguments_are_refused():
    with pytest.raises(ValueError, match=r"weight must be at least 1, got 0\.5"):
        ThroughObstacles(weight=0.5)
    with pytest.raises(ValueError, match="occupancy must be at least 4 x 4, got 3 x 80"):
        ThroughObstacles().plan(FREE[:, :3], START, GOAL)
    with pytest.raises(
        ValueError, match=r"of the camera's size, 256 x 256, to have bounds, got 64 x 80"
    ):
        ThroughObstacles(bounds=Rectangle((0.2, -0.3), (0.7, 0.3))).plan(FREE, START, GOAL)
