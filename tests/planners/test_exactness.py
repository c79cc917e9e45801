"""Lazy Theta* and the distance field against an optimum that they had no part in."""

import itertools

import numpy as np
import pytest
import scipy.ndimage as ndi
import torch
from hypothesis import given, settings, strategies as st
from planner_maps import family_maps, shortest_length, solvable_maps, visible

from modpush.planners import DistanceField, LazyThetaStar, StraightLine

EXACT = {"corners": LazyThetaStar(), "field": DistanceField()}
CLOSE = {"lazy_grid": LazyThetaStar(nodes="grid")}


def plan(planner, blocked, start, goal):
    return planner.plan(
        torch.from_numpy(np.ascontiguousarray(blocked))[None],
        torch.as_tensor(np.asarray(start, np.float32).copy())[None],
        torch.as_tensor(np.asarray(goal, np.float32).copy())[None],
    )


def check_against_optimum(maps):
    ratios = {name: [] for name in {**EXACT, **CLOSE}}
    for blocked, start, goal in maps:
        optimum = shortest_length(blocked, start, goal)
        for name, planner in {**EXACT, **CLOSE}.items():
            paths = plan(planner, blocked, start, goal)
            assert paths.found.item()
            assert not paths.start_moved.item()
            ratios[name].append(paths.length.item() / optimum)
            points = paths.waypoints[0, : paths.count[0]].double().numpy()
            assert (points[0] == start).all()
            assert (points[-1] == goal).all()
            for a, b in itertools.pairwise(points):
                assert visible(blocked, a, b), (name, a, b)
            legs = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
            assert legs == pytest.approx(paths.length.item(), rel=1e-5)
    for name, values in ratios.items():
        array = np.array(values)
        assert array.min() > 1 - 1e-6, name
        if name in EXACT:
            assert array.max() < 1 + 1e-6, name
        assert array.mean() <= 1.005, name
        assert array.max() <= 1.10, name
    return ratios


def test_lengths_are_the_any_angle_optimum_on_random_maps():
    check_against_optimum(solvable_maps(7, 30))


def test_lengths_are_the_any_angle_optimum_in_the_paper_s_families():
    check_against_optimum(family_maps(8, 30))


@pytest.mark.slow
def test_lengths_are_the_any_angle_optimum_on_200_maps_of_each_kind():
    for kind, maps in (("random", solvable_maps(0, 200)), ("families", family_maps(1, 200))):
        for name, values in check_against_optimum(maps).items():
            print(f"{kind:9} {name:10} mean {np.mean(values):.5f} worst {np.max(values):.5f}")


small_maps = st.integers(0, 2**32 - 1)


def small_case(seed, share=None):
    """A small map, noise or blocks, with two distinct free points that need not be joined."""
    rng = np.random.default_rng(seed)
    height, width = rng.integers(3, 15, 2)
    blocked = rng.random((height, width)) < (rng.uniform(0.05, 0.6) if share is None else share)
    if rng.random() < 0.5:
        blocked = np.kron(blocked, np.ones((2, 3), bool)).astype(bool)
    blocked[rng.integers(blocked.shape[0]), rng.integers(blocked.shape[1])] = False
    free = np.argwhere(~blocked)[:, ::-1].astype(np.float32)
    start, goal = free[rng.integers(len(free), size=2)]
    if rng.random() < 0.5:  # anywhere in the cell, not just at its centre
        start = start + rng.uniform(-0.49, 0.49, 2).astype(np.float32)
        goal = goal + rng.uniform(-0.49, 0.49, 2).astype(np.float32)
    return blocked, start, goal


@settings(max_examples=150, deadline=None)
@given(small_maps)
def test_small_maps_exactly(seed):
    blocked, start, goal = small_case(seed)
    optimum = shortest_length(blocked, start, goal) if (start != goal).any() else 0.0
    for planner in EXACT.values():
        length = plan(planner, blocked, start, goal).length.item()
        assert length == pytest.approx(optimum, rel=1e-5, abs=1e-5)
    for planner in CLOSE.values():
        length = plan(planner, blocked, start, goal).length.item()
        # In a few cells' distance half a cell is much: the bound is absolute there.
        assert optimum - 1e-4 <= length <= 1.05 * optimum + 1.0


@settings(max_examples=150, deadline=None)
@given(small_maps)
def test_found_exactly_when_free_cells_join_the_ends(seed):
    blocked, start, goal = small_case(seed)
    label, _ = ndi.label(~blocked)
    cells = np.rint([start, goal]).astype(int)
    joined = label[cells[0][1], cells[0][0]] == label[cells[1][1], cells[1][0]]
    for planner in {**EXACT, **CLOSE}.values():
        paths = plan(planner, blocked, start, goal)
        assert paths.found.item() == joined
        assert (paths.count.item() > 0) == joined
        assert np.isfinite(paths.length.item()) == joined


SYMMETRIES = [
    lambda m, p: (m[:, ::-1], [m.shape[1] - 1 - p[0], p[1]]),
    lambda m, p: (m[::-1], [p[0], m.shape[0] - 1 - p[1]]),
    lambda m, p: (m.T, [p[1], p[0]]),
    lambda m, p: (np.rot90(m), [p[1], m.shape[1] - 1 - p[0]]),
]


@settings(max_examples=60, deadline=None)
@given(small_maps, st.sampled_from(range(len(SYMMETRIES))))
def test_flips_and_rotations_leave_the_length(seed, which):
    blocked, start, goal = small_case(seed)
    turned, turned_start = SYMMETRIES[which](blocked, start)
    _, turned_goal = SYMMETRIES[which](blocked, goal)
    for planner in EXACT.values():
        length = plan(planner, blocked, start, goal).length.item()
        again = plan(planner, turned, turned_start, turned_goal).length.item()
        assert again == pytest.approx(length, rel=1e-5, abs=1e-5)


@settings(max_examples=60, deadline=None)
@given(small_maps)
def test_more_obstacles_never_shorten_the_way(seed):
    blocked, start, goal = small_case(seed)
    rng = np.random.default_rng(seed)
    more = blocked | (rng.random(blocked.shape) < 0.15)
    for point in np.rint([start, goal]).astype(int):
        more[point[1], point[0]] = False
    for planner in EXACT.values():
        length = plan(planner, blocked, start, goal).length.item()
        assert plan(planner, more, start, goal).length.item() >= length - 1e-4


@settings(max_examples=60, deadline=None)
@given(small_maps)
def test_there_and_back_are_as_long(seed):
    blocked, start, goal = small_case(seed)
    for planner in EXACT.values():
        there = plan(planner, blocked, start, goal).length.item()
        assert plan(planner, blocked, goal, start).length.item() == pytest.approx(there, rel=1e-5)
    for planner in CLOSE.values():
        there = plan(planner, blocked, start, goal).length.item()
        back = plan(planner, blocked, goal, start).length.item()
        assert back == pytest.approx(there, rel=0.05, abs=1.0)


def test_a_path_round_one_cell_by_hand():
    # From (0, 1) past the cell (1, 1) to (2, 1): over the corners (0.5, 0.5) and (1.5, 0.5) of
    # that cell, so sqrt(0.5^2 + 0.5^2) twice and 1 between.
    blocked = np.zeros((3, 3), bool)
    blocked[1, 1] = True
    for planner in {**EXACT, **CLOSE}.values():
        paths = plan(planner, blocked, [0, 1], [2, 1])
        assert paths.length.item() == pytest.approx(2 * 0.5**0.5 + 1, rel=1e-6)
        assert paths.count.item() == 4
    assert not plan(StraightLine(), blocked, [0, 1], [2, 1]).found.item()
    assert plan(StraightLine(), blocked, [0, 0], [2, 0]).length.item() == 2.0


def test_a_straight_line_is_found_exactly_when_the_ends_see_each_other():
    line, answers = StraightLine(), set()
    for blocked, start, goal in solvable_maps(5, 40, boxes=4):
        paths = plan(line, blocked, start, goal)
        assert paths.found.item() == visible(blocked, start, goal)
        answers.add(paths.found.item())
    assert answers == {True, False}
