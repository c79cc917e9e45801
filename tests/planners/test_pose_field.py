"""PoseField: costs by brute force, gaps that only an oblong object passes, ends that are not free."""

import heapq
import math
from itertools import pairwise

import numpy as np
import pytest
import torch

from modpush.geometry import CAMERA, Camera
from modpush.planners import LazyThetaStar, PoseField, inflate, polygon_support, poses_along
from tests.planners.test_threads import assert_threads_get_the_same

SMALL = Camera(height=40, width=48, z=0.25)  # pixels of 5 mm
HALF = torch.tensor([[1, 1], [1, -1], [-1, 1], [-1, -1]]) / 2
BOX = polygon_support(HALF * torch.tensor([0.1, 0.05]))  # 10 x 5 cm
SHAPES = {  # extents, and the number of yaw angles at which the footprint looks the same
    "oblong": (polygon_support(HALF * torch.tensor([0.0613, 0.0271])), 2),
    "square": (polygon_support(HALF * 0.0377), 4),
    "wedge": (
        polygon_support(torch.tensor([[0.041, 0.003], [-0.022, 0.026], [-0.018, -0.024]])),
        1,
    ),
    "disc": (torch.full((12,), 0.0173), 0),
}


def noise_map(seed, camera=SMALL, share=0.01):
    rng = np.random.default_rng(seed)
    return torch.from_numpy(rng.random((1, camera.height, camera.width)) < share)


def wall_with_gap(width, camera=CAMERA, x=0.6):
    """A wall across the table, 6 cm thick, with a gap in its middle, `[1, H, W]`."""
    v, u = np.mgrid[: camera.height, : camera.width]
    place = camera.unproject(np.stack([u, v], -1))
    wall = (abs(place[..., 0] - x) < 0.03) & (abs(place[..., 1]) > width / 2)
    return torch.from_numpy(wall)[None]


def covered(blocked, support, pose, camera, tolerance=1e-6):
    """True if the footprint at a pose covers the centre of a blocked pixel."""
    v, u = blocked.numpy().nonzero()
    points = camera.unproject(np.stack([u, v], -1).astype(float)) - np.asarray(pose[:2])
    angle = pose[2] + 2 * np.pi * np.arange(len(support)) / len(support)
    along = points @ np.stack([np.cos(angle), np.sin(angle)])
    return bool((along <= support.numpy() + tolerance * camera.cell_size).all(-1).any())


def ways_to_neighbours(field, pose, support, symmetry):
    """Cost of the way from a pose to each of the grid's poses around it, inf to others, `[K, R, C]`."""
    layers = 1 if symmetry == 0 else math.ceil(field.yaws / symmetry)
    period = 2 * math.pi / max(symmetry, 1)
    turn = np.arange(layers) * period / layers - pose[2]
    turn = abs((turn + period / 2) % period - period / 2)[:, None, None]
    offset = abs(field.positions.double().numpy() - pose[:2])
    near = (offset < field.resolution * 0.9999).all(-1)
    if layers == 1:
        return np.where(near, np.hypot(*offset.T).T, np.inf)[None]
    near = near & (turn < period / layers * 0.9999)
    return np.where(near, np.hypot(*offset.T).T + float(support.max()) * turn, np.inf)


def search_by_heap(field, blocked, support, goal, symmetry):
    """Costs of all the grid's poses, `[K, rows, columns]`, by the textbook's search."""
    places = field.positions.double().numpy()
    rows, columns = places.shape[:2]
    layers = 1 if symmetry == 0 else math.ceil(field.yaws / symmetry)
    step = 2 * math.pi / (max(symmetry, 1) * layers)
    free = np.zeros((layers, rows, columns), bool)
    for k, r, c in np.ndindex(free.shape):
        free[k, r, c] = not covered(blocked, support, (*places[r, c], k * step), field.camera)
    radius = float(support.max())
    cost = np.full(free.shape, np.inf)
    begin = ways_to_neighbours(field, goal, support, symmetry)
    heap = [(begin[n], *n) for n in zip(*(free & (begin < np.inf)).nonzero(), strict=True)]
    heapq.heapify(heap)
    while heap:
        value, k, r, c = heapq.heappop(heap)
        if value >= cost[k, r, c]:
            continue
        cost[k, r, c] = value
        for dk, dr, dc in np.ndindex(3, 3, 3):
            dk, dr, dc = dk - 1, dr - 1, dc - 1
            n = ((k + dk) % layers, r + dr, c + dc)
            inside = 0 <= n[1] < rows and 0 <= n[2] < columns
            if (dk and (dr or dc)) or not inside or not free[n]:
                continue
            if dr and dc and not (free[k, r + dr, c] and free[k, r, c + dc]):
                continue
            way = field.resolution * math.hypot(dr, dc) + abs(dk) * radius * step
            if value + way < cost[n]:
                heapq.heappush(heap, (value + way, *n))
    return cost


@pytest.mark.parametrize("full_circle", [False, True])
@pytest.mark.parametrize("shape", SHAPES)
def test_costs_are_those_of_brute_force(shape, full_circle):
    support, order = SHAPES[shape]
    symmetry = 1 if full_circle else order
    field = PoseField(SMALL, resolution=0.015, yaws=12)
    for seed in range(3):
        blocked = noise_map(seed)
        goal = torch.tensor([[0.62, 0.01 * seed - 0.01, 0.4 * seed - 0.7]])
        expected = search_by_heap(field, blocked[0], support, goal[0].double().numpy(), symmetry)
        cost = field.cost_to_go(blocked, support[None], goal, symmetry)[0].numpy()
        assert np.isfinite(expected).mean() > 0.05
        assert np.isinf(expected).any() or shape == "disc"
        np.testing.assert_allclose(cost, expected, rtol=1e-5, atol=1e-6)


def test_an_oblong_object_is_led_lengthwise_through_a_gap_too_narrow_for_its_circle():
    blocked = wall_with_gap(0.08)
    start, goal = torch.tensor([[[0.45, -0.1, 1.5]], [[0.75, 0.1, 1.3]]])
    pixels = [CAMERA.project(pose[:, :2]) for pose in (start, goal)]
    circle = inflate(blocked, 0.0559 / CAMERA.cell_size)
    assert not LazyThetaStar().plan(circle, *pixels).found
    for resolution in (0.02, 0.01):
        field = PoseField(resolution=resolution, clearance=0.003)
        assert not field.plan(blocked, torch.full((1, 48), 0.0559), start, goal, 0).found
        paths = field.plan(blocked, BOX[None], start, goal, 2)
        assert paths.found
        poses = poses_along(paths, torch.linspace(0, paths.length.item(), 300))[0]
        assert not any(covered(blocked[0], BOX, pose.tolist(), CAMERA) for pose in poses)
        inside = (poses[:, 0] - 0.6).abs() < 0.02
        assert inside.any()
        assert (poses[inside, 2].sin().abs() < 0.5).all()
        # Crosswise it does not fit.
        assert covered(blocked[0], BOX, (0.6, 0.0, math.pi / 2), CAMERA)


@pytest.mark.parametrize("shape", SHAPES)
def test_paths_lead_to_the_goal_and_fall_short_of_no_bound(shape):
    support, symmetry = SHAPES[shape]
    field = PoseField(SMALL, resolution=0.01, yaws=24)
    period = 2 * math.pi / max(symmetry, 1)
    found = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        low, high = (0.55, -0.1, -3), (0.68, 0.1, 3)
        start, goal = torch.from_numpy(rng.uniform(low, high, (2, 1, 3)))
        scene = noise_map(seed, share=0.005), support[None]
        paths = field.plan(*scene, start, goal, symmetry)
        if not paths.found or paths.start_moved or paths.goal_moved:
            continue
        found += 1
        count, points = int(paths.count), paths.waypoints[0].double()
        torch.testing.assert_close(points[0], start[0], atol=1e-6, rtol=0)
        torch.testing.assert_close(points[-1, :2], goal[0, :2], atol=1e-6, rtol=0)
        if symmetry:
            turns = (points[-1, 2] - goal[0, 2]) / period
            assert abs(turns - turns.round()) < 1e-6
        along = paths.along[0, :count].tolist()
        assert all(a < b for a, b in pairwise(along))
        assert paths.length.item() == along[-1]
        moves = (points[1:] - points[:-1])[: count - 1]
        radius = float(support.max()) if symmetry else 0.0
        lengths = moves[:, :2].norm(dim=-1) + radius * moves[:, 2].abs()
        torch.testing.assert_close(lengths.sum().float(), paths.length[0], atol=1e-5, rtol=1e-5)
        assert paths.length >= field.straight_cost(support[None], start, goal, symmetry) - 1e-6
        # No longer than over the grid, and what is left falls along the way.
        cost = field.cost_to_go(*scene, goal, symmetry)[0].double().numpy()
        first = ways_to_neighbours(field, start[0].numpy(), support, symmetry)
        assert paths.length.item() <= (cost + first).min() + 1e-5
        part = poses_along(paths, [0.5 * paths.length.item()])[:, 0]
        rest = field.plan(*scene, part, goal, symmetry)
        assert rest.length <= 0.5 * paths.length + 0.01
    assert found >= 5


def test_on_an_empty_table_the_way_is_straight():
    field = PoseField()
    empty = torch.zeros(2, 256, 256, dtype=torch.bool)
    start = torch.tensor([[0.4, 0.1, 0.2]]).repeat(2, 1)
    goal = torch.tensor([[0.7, -0.3, 0.5 - math.pi], [0.7, -0.3, 0.5]])
    paths = field.plan(empty, BOX.expand(2, -1), start, goal, torch.tensor([2.0, 1.0]))
    # 0.3 forward and 0.4 aside are 0.5; 0.3 rad at a radius of nearly hypot(5, 2.5) cm = 5.59 cm
    torch.testing.assert_close(
        paths.length, torch.full((2,), 0.5 + 0.3 * 0.0559), atol=2e-4, rtol=0
    )
    torch.testing.assert_close(paths.waypoints[:, -1, 2], torch.tensor([0.5, 0.5]))
    assert paths.count.tolist() == [2, 2]
    full = field.plan(empty, BOX.expand(2, -1), start, goal)
    assert full.length[0] - full.length[1] == pytest.approx((math.pi - 0.6) * 0.0559, abs=1e-3)
    dear = PoseField(turning_radius=0.2).plan(empty, BOX.expand(2, -1), start, goal, 2)
    torch.testing.assert_close(dear.length, torch.full((2,), 0.5 + 0.3 * 0.2), atol=1e-5, rtol=0)


def some_scenes(batch, seed=0):
    blocked = torch.cat([noise_map(seed + b) for b in range(batch)])
    rng = np.random.default_rng(seed)
    low, high = (0.5, -0.12, -3), (0.7, 0.12, 3)
    start, goal = torch.from_numpy(rng.uniform(low, high, (2, batch, 3)))
    support = torch.stack([list(SHAPES.values())[b % 3][0] for b in range(batch)])
    symmetry = torch.tensor([list(SHAPES.values())[b % 3][1] for b in range(batch)])
    return blocked, support, start, goal, symmetry


def test_a_field_is_built_once_for_a_map_and_goal():
    field = PoseField(SMALL)
    blocked, support, start, goal, symmetry = some_scenes(4)
    first = field.plan(blocked, support, start, goal, symmetry)
    assert field.builds == 4
    field.plan(blocked, support, start + 0.01, goal, symmetry)
    again = field.plan(blocked.clone(), support, start, goal, symmetry)
    assert field.builds == 4
    goal[2] += 0.05
    blocked[3, 20, 20] ^= True
    field.plan(blocked, support, start, goal, symmetry)
    assert field.builds == 6
    for name, value in vars(first).items():
        assert torch.equal(value, vars(again)[name])


@pytest.mark.parametrize("threads", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_batch_is_planned_as_its_scenes_alone_whatever_was_planned_before(threads):
    torch.set_num_threads(threads)
    scenes = some_scenes(6)
    field = PoseField(SMALL, resolution=0.01)
    field.plan(*some_scenes(6, seed=50))
    together = field.plan(*scenes)
    torch.set_num_threads(1)
    for b in range(6):
        alone = PoseField(SMALL, resolution=0.01).plan(*(part[b : b + 1] for part in scenes))
        count = int(together.count[b])
        assert torch.equal(together.waypoints[b, :count], alone.waypoints[0, :count])
        assert torch.equal(together.length[b], alone.length[0])
    goals = scenes[3] + torch.tensor([0.0, 0.03, 0.3])
    moved = field.plan(*scenes[:3], goals, scenes[4])  # the map is kept, the goals are new
    fresh = PoseField(SMALL, resolution=0.01).plan(*scenes[:3], goals, scenes[4])
    assert torch.equal(moved.length, fresh.length)


def test_threads_may_share_a_field():
    field = PoseField(SMALL)
    inputs = [some_scenes(batch, seed=batch) for batch in (1, 2, 3, 3)]
    assert_threads_get_the_same(lambda *query: vars(field.plan(*query)).values(), inputs, rounds=5)


def test_bits_of_an_occupancy_map_do_as_well():
    blocked, *rest = some_scenes(2)
    bits = np.zeros((2, 40, 8), np.uint8)
    bits[..., :6] = np.packbits(blocked.numpy(), axis=-1, bitorder="little")
    field = PoseField(SMALL)
    expected = field.plan(blocked, *rest)
    assert torch.equal(field.plan(torch.from_numpy(bits), *rest).length, expected.length)


def walls(*columns):
    blocked = torch.zeros(1, 256, 256, dtype=torch.bool)
    for u in columns:
        blocked[..., u : u + 3] = True
    return blocked


@pytest.mark.parametrize(
    ("blocked", "start", "goal", "expected"),
    [
        # found, start moved, goal moved
        (walls(120), [0.5, 0.3, 0.0], [0.5, 0.3, 1.0], (True, False, False)),
        (walls(120), [0.5, 0.3, 0.0], [0.5, -0.3, 0.0], (False, False, False)),
        (walls(120), [0.5, 0.028, 0.0], [0.5, 0.3, 0.0], (True, True, False)),
        (walls(120), [0.5, 0.3, 0.0], [0.5, 0.028, 0.0], (True, False, True)),
        (walls(), [0.5, 0.0, 0.0], [2.0, 0.0, 0.0], (True, False, True)),
        (walls(), [-1.0, 0.0, 0.0], [0.5, 0.0, 0.0], (True, True, False)),
        (~walls(), [0.5, 0.0, 0.0], [0.6, 0.0, 0.0], (False, True, True)),
        (~walls(), [0.5, 0.0, 0.7], [0.5, 0.0, 0.7], (True, True, True)),
    ],
)
def test_ends_that_are_not_free(blocked, start, goal, expected):
    ends = torch.tensor([start]), torch.tensor([goal])
    paths = PoseField().plan(blocked, BOX[None], *ends, 2)
    found = bool(paths.found)
    assert (found, bool(paths.start_moved), bool(paths.goal_moved)) == expected
    torch.testing.assert_close(paths.waypoints[0, 0], ends[0][0])
    last = ends[1] if found else ends[0]
    torch.testing.assert_close(paths.waypoints[0, -1, :2], last[0, :2])
    if not found:
        assert (paths.count.item(), paths.length.item()) == (0, math.inf)
    if start == goal:
        assert paths.length.item() == 0.0


def test_the_centre_stays_within_the_bounds():
    blocked, start = wall_with_gap(0.2), torch.tensor([[0.4, 0.0, 0.0]])
    goal = torch.tensor([[0.8, 0.0, 0.0]])
    bounds = ((0.35, 0.12), (0.85, 0.4))
    field = PoseField(bounds=bounds)
    assert (field.positions.amin((0, 1)) >= torch.tensor(bounds[0]) - 1e-6).all()
    assert (field.positions.amax((0, 1)) <= torch.tensor(bounds[1]) + 1e-6).all()
    assert PoseField().plan(blocked, BOX[None], start, goal, 2).found
    assert not field.plan(blocked, BOX[None], start, goal, 2).found
