"""What all planners promise: bad input, ends that are not free, memory, batches, copies."""

import copy
import math
import multiprocessing
import os
import pickle
import subprocess
import sys

import numpy as np
import pytest
import torch
from planner_maps import random_map, random_query

from modpush.planners import (
    AStar,
    DistanceField,
    LazyThetaStar,
    StraightLine,
    point_along,
)

MAKERS = {
    "lazy": LazyThetaStar,
    "lazy_grid": lambda **kwargs: LazyThetaStar(nodes="grid", **kwargs),
    "a_star": AStar,
    "field": DistanceField,
    "line": StraightLine,
}
every_planner = pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS.keys())
# A planner's kernel for several threads takes up to a minute to compile. All of them call the serial
# search in a parallel loop over the scenes.
QUICK_ON_THREADS = ("lazy", "line")
every_planner_on_threads = pytest.mark.parametrize(
    "make",
    [
        pytest.param(make, id=name, marks=[] if name in QUICK_ON_THREADS else pytest.mark.slow)
        for name, make in MAKERS.items()
    ],
)


def wall_map(side=20):
    """A wall with a gap at its right end."""
    blocked = torch.zeros(1, side, side, dtype=torch.bool)
    blocked[0, 8:12, : side - 4] = True
    return blocked


@pytest.fixture
def two_threads():
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(1)


def xy(u, v):
    return torch.tensor([[float(u), float(v)]])


FREE = torch.zeros(1, 4, 4, dtype=torch.bool)


@every_planner
@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"occupancy": torch.zeros(1, 4, 4)}, TypeError, "torch.bool tensor, got torch.float32"),
        ({"occupancy": np.zeros((1, 4, 4), bool)}, TypeError, "torch.bool tensor, got numpy.nd"),
        ({"occupancy": FREE[0]}, ValueError, r"H and W from 1 to 4096, got \[4, 4\]"),
        ({"occupancy": FREE[:, :0]}, ValueError, r"H and W from 1 to 4096, got \[1, 0, 4\]"),
        ({"start": torch.zeros(2, 2)}, ValueError, r"start must be \[B, 2\] = \[1, 2\], got \[2,"),
        ({"start": xy(0, math.nan)}, ValueError, r"start is not finite in scene\(s\) \[0\]"),
        ({"start": np.zeros((1, 2))}, TypeError, "start must be a floating point tensor, got nd"),
        ({"goal": xy(1, 1).long()}, TypeError, "goal must be a floating point tensor, got torch.i"),
    ],
)
def test_bad_input_is_named(make, change, error, message):
    with pytest.raises(error, match=message):
        make().plan(**{"occupancy": FREE, "start": xy(0, 0), "goal": xy(1, 1), **change})


@every_planner
def test_cell_size_scales_lengths(make):
    paths = make(cell_size=0.5).plan(wall_map(), xy(0, 0), xy(3, 4))
    assert paths.length.item() >= 2.5
    assert paths.length.item() == pytest.approx(
        make().plan(wall_map(), xy(0, 0), xy(3, 4)).length / 2
    )


@every_planner
def test_a_start_inside_an_obstacle_leaves_it_by_the_nearest_free_cell(make):
    # (2, 9) is the wall's second row; the nearest free centre is (2, 7).
    paths = make().plan(wall_map(), xy(2, 9), xy(2, 1))
    assert paths.found.item()
    assert paths.start_moved.item()
    assert not paths.goal_moved.item()
    assert paths.waypoints[0, 0].tolist() == [2, 9]
    assert paths.waypoints[0, 1].tolist() == [2, 7]
    assert paths.length.item() == pytest.approx(8.0)


@every_planner
def test_no_path_is_an_answer(make):
    blocked = torch.zeros(2, 9, 9, dtype=torch.bool)
    blocked[0, 4] = True
    paths = make().plan(blocked, xy(4, 1).repeat(2, 1), xy(4, 7).repeat(2, 1))
    assert paths.found.tolist() == [False, True]
    assert paths.length.tolist() == [float("inf"), 6.0]
    assert paths.count.tolist() == [0, 2]
    assert (paths.waypoints[0] == xy(4, 1)).all()


@every_planner
@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (7, 1), (3, 5), (64, 64), (65, 130)])
def test_all_grid_sizes(make, shape):
    blocked = torch.zeros(1, *shape, dtype=torch.bool)
    goal = xy(shape[1] - 1, shape[0] - 1)
    paths = make().plan(blocked, xy(0, 0), goal)
    assert paths.found.item()
    assert paths.length.item() >= goal.norm().item() - 1e-4


@every_planner_on_threads
def test_a_batch_on_two_threads_gives_what_its_scenes_give_alone(make, two_threads):
    rng = np.random.default_rng(5)
    maps = [random_map(rng, side=96, boxes=5, radius=4) for _ in range(6)]
    queries = [random_query(rng, blocked) for blocked in maps]
    occupancy = torch.from_numpy(np.stack(maps))
    start = torch.from_numpy(np.stack([a for a, _ in queries]))
    goal = torch.from_numpy(np.stack([b for _, b in queries]))
    together = make().plan(occupancy, start, goal)
    one = make()
    for b in range(len(maps)):
        alone = one.plan(occupancy[b : b + 1], start[b : b + 1], goal[b : b + 1])
        count = int(together.count[b])
        assert alone.found.item() == together.found[b].item()
        assert alone.length.item() == together.length[b].item()
        assert alone.count.item() == count
        assert torch.equal(alone.waypoints[0, :count], together.waypoints[b, :count])
        padding = together.waypoints[b, count:]
        assert (padding == (goal[b] if count else start[b])).all()


@every_planner
def test_memory_of_earlier_calls_never_shows(make):
    # Scenes change place, map and goal from call to call; a planner without memory agrees.
    rng = np.random.default_rng(6)
    maps = [random_map(rng, side=64, boxes=4, radius=3) for _ in range(4)]
    old = make()
    for _ in range(25):
        rows = rng.integers(len(maps), size=3)
        occupancy = torch.from_numpy(np.stack([maps[k] for k in rows]))
        start, goal = torch.from_numpy(rng.uniform(-2, 66, (2, 3, 2)).astype(np.float32))
        if rng.random() < 0.5:
            goal = torch.full((3, 2), 60.0)
        assert torch.equal(
            old.plan(occupancy, start, goal).length, make().plan(occupancy, start, goal).length
        )


@every_planner
def test_copies_and_pickles_plan_alike(make):
    planner = make(cell_size=0.1)
    planner.plan(wall_map(), xy(2, 2), xy(2, 17))
    expected = planner.plan(wall_map(), xy(2, 2), xy(2, 17)).length
    for other in (copy.deepcopy(planner), pickle.loads(pickle.dumps(planner))):
        assert torch.equal(other.plan(wall_map(), xy(2, 2), xy(2, 17)).length, expected)
    assert len(pickle.dumps(planner)) < 2000


def _length_in_child(queue):
    maps = wall_map().repeat(4, 1, 1)
    ends = xy(2, 2).repeat(4, 1), xy(2, 17).repeat(4, 1)
    queue.put(LazyThetaStar().plan(maps, *ends).length.tolist())


def test_a_forked_child_of_a_process_that_used_threads_can_plan(two_threads):
    # OpenMP aborts a forked child at its first parallel loop; the kernels go serial there.
    maps = wall_map().repeat(4, 1, 1)
    ends = xy(2, 2).repeat(4, 1), xy(2, 17).repeat(4, 1)
    expected = LazyThetaStar().plan(maps, *ends).length.tolist()
    context = multiprocessing.get_context("fork")
    queue = context.Queue()
    child = context.Process(target=_length_in_child, args=(queue,))
    child.start()
    assert queue.get(timeout=60) == expected
    child.join(timeout=60)
    assert child.exitcode == 0


def test_a_process_that_torch_has_one_thread_in_plans_on_one(monkeypatch):
    def refuse(*arguments):
        raise AssertionError("the parallel kernel was called")

    monkeypatch.setattr("modpush.planners.any_angle.plan_over_corners._parallel", refuse)
    maps = wall_map().repeat(4, 1, 1)
    ends = xy(2, 2).repeat(4, 1), xy(2, 17).repeat(4, 1)
    assert LazyThetaStar().plan(maps, *ends).found.all()
    torch.set_num_threads(2)
    try:
        with pytest.raises(AssertionError, match="the parallel kernel was called"):
            LazyThetaStar().plan(maps, *ends)
    finally:
        torch.set_num_threads(1)


def test_a_field_is_built_once_and_again_when_map_or_goal_change():
    field, blocked = DistanceField(), wall_map()
    for v in range(7):
        field.plan(blocked, xy(2, v), xy(2, 17))
    assert field.builds == 1
    field.plan(blocked, xy(2, 2), xy(3, 17))
    assert field.builds == 2
    blocked[0, 15, 5] = True
    field.plan(blocked, xy(2, 2), xy(3, 17))
    assert field.builds == 3
    field.plan(blocked, xy(2, 6), xy(9, 6))  # a straight line needs no field
    assert field.builds == 3


def test_a_noisy_map_is_searched_over_the_grid():
    # More than 2048 corners: as good as the grid search, not exact.
    rng = np.random.default_rng(1)
    blocked = torch.from_numpy(rng.random((1, 128, 128)) < 0.25)
    blocked[0, 0, 0] = blocked[0, -1, -1] = False
    ends = xy(0, 0), xy(127, 127)
    expected = LazyThetaStar(nodes="grid").plan(blocked, *ends)
    assert expected.found.item()
    for planner in (LazyThetaStar(), DistanceField()):
        assert torch.equal(planner.plan(blocked, *ends).length, expected.length)


def test_a_path_of_many_waypoints_is_kept_whole():
    # A comb: the way winds through 40 teeth, two waypoints each.
    blocked = torch.zeros(1, 21, 161, dtype=torch.bool)
    for k in range(40):
        rows = slice(0, 20) if k % 2 else slice(1, 21)
        blocked[0, rows, 4 * k + 2] = True
    paths = LazyThetaStar().plan(blocked, xy(0, 10), xy(160, 10))
    assert paths.found.item()
    assert paths.count.item() > 70
    assert paths.waypoints.shape[1] == paths.count.item()


def test_point_along_a_bent_line_by_hand():
    line = torch.tensor([[0.0, 0.0], [3.0, 0.0], [3.0, 4.0], [3.0, 4.0]]).repeat(5, 1, 1)
    distance = torch.tensor([-1.0, 1.5, 3.0, 5.0, 99.0])
    expected = torch.tensor([[0.0, 0.0], [1.5, 0.0], [3.0, 0.0], [3.0, 2.0], [3.0, 4.0]])
    torch.testing.assert_close(point_along(line, distance), expected)
    still = torch.ones(1, 3, 2)
    assert point_along(still, torch.tensor([0.5])).tolist() == [[1.0, 1.0]]


NOTHING_LEFT_TO_COMPILE = """
import sys
import numba
import torch
from modpush._kernels import BatchKernel
import modpush.geometry as geometry
import modpush.planners as planners

def compiled():
    modules = [m for name, m in sys.modules.items() if name.startswith("modpush.planners")]
    kernels = {k for m in modules for k in vars(m).values() if isinstance(k, BatchKernel)}
    return sum(len(form.signatures) for k in kernels for form in (k._serial, k._parallel))

planners.warmup(32, 48)
warm = compiled()
torch.manual_seed(0)
for batch in (1, 3):
    blocked = torch.rand(batch, 40, 56) < 0.1
    start, goal = torch.zeros(batch, 2), torch.full((batch, 2), 39.0)
    for kind in (planners.AStar, planners.DistanceField, planners.LazyThetaStar,
                 planners.StraightLine):
        kind().plan(blocked, start, goal)
    planners.LazyThetaStar(nodes="grid").plan(blocked, start, goal)
    planners.inflate(blocked, 2.0)
    camera = geometry.Camera(height=40, width=56)
    planners.OccupancyMap(camera)(torch.full((batch, 40, 56), camera.z), 0.035)
print(warm, compiled())
"""
NUMBER_OF_THREADS = """
torch.set_num_threads(2)
for _ in range(2):
    planners.inflate(torch.zeros(8, 32, 32, dtype=torch.bool), 2.0)
    print(torch.get_num_threads(), numba.get_num_threads())
"""


@pytest.mark.parametrize("threads", ["1", pytest.param("2", marks=pytest.mark.slow)])
def test_after_warmup_nothing_is_left_to_compile_and_torch_keeps_its_number_of_threads(threads):
    # In a process of its own: in this one other tests have compiled what there is.
    script = [sys.executable, "-c", NOTHING_LEFT_TO_COMPILE + NUMBER_OF_THREADS]
    environment = {**os.environ, "OMP_NUM_THREADS": threads, "NUMBA_NUM_THREADS": "4"}
    done = subprocess.run(script, capture_output=True, text=True, check=True, env=environment)
    warm, after, *numbers = map(int, done.stdout.split())
    assert warm == after
    assert warm >= 6  # a kernel for each search, inflation, occupancy from depth
    assert numbers == [2, 2, 2, 2]  # where there are more cores
