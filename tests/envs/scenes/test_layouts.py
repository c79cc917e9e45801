import math

import numpy as np
import pytest

from modpush.envs.robot.named import TOOLS
from modpush.envs.scenes.layouts import (
    HARD_SCENES,
    HARD_TUNING_SCENES,
    HARD_WIDE_SCENES,
    OBSTACLE_SCENES,
    get_scene,
)
from modpush.envs.scenes.objects import get_object
from modpush.envs.scenes.obstacle import Obstacle
from modpush.envs.scenes.rectangles import obstacle_distance


def build(name: str, difficulty: float, seed: int = 0) -> list[Obstacle]:
    return get_scene(name)[1](np.random.default_rng(seed), difficulty)


def free_gap(a: Obstacle, b: Obstacle) -> float:
    """Least distance between two rectangles, from points along the first one's outline [m]."""
    length, width, _ = a.size
    t = np.linspace(-0.5, 0.5, 401)
    sides = [
        *[np.stack([t * length, np.full_like(t, s * width / 2)], -1) for s in (-1, 1)],
        *[np.stack([np.full_like(t, s * length / 2), t * width], -1) for s in (-1, 1)],
    ]
    x, y, yaw = a.pose
    turn = np.array([[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]])
    return float(obstacle_distance(np.vstack(sides) @ turn + [x, y], [b]).min())


@pytest.mark.parametrize(("difficulty", "gap"), [(0.0, 0.20), (0.5, 0.15), (1.0, 0.10)])
@pytest.mark.parametrize("name", ["slot", "corridor", "zigzag"])
def test_gaps_shrink_from_20_to_10_cm(name, difficulty, gap) -> None:
    assert free_gap(*build(name, difficulty)) == pytest.approx(gap, abs=1e-6)


@pytest.mark.parametrize(("difficulty", "gap"), [(0.0, 0.20), (1.0, 0.10)])
def test_neighbouring_posts_are_a_gap_apart(difficulty, gap) -> None:
    first, *others = build("posts", difficulty)
    assert sorted(free_gap(first, other) for other in others)[:2] == pytest.approx([gap, gap])


@pytest.mark.parametrize("name", ["bar_across", "bar_along"])
def test_a_bar_grows_from_10_to_60_cm_and_turns_by_45_degrees_at_most(name) -> None:
    base = {"bar_across": math.pi / 2, "bar_along": 0.0}[name]
    for seed in range(50):
        (short,), (long,) = build(name, 0.0, seed), build(name, 1.0, seed)
        assert short.size == pytest.approx((0.10, 0.06, 0.06))
        assert long.size == pytest.approx((0.60, 0.06, 0.06))
        assert abs(long.pose[2] - base) <= math.pi / 4


def test_hard_scenes_are_the_authors_turned_by_90_degrees() -> None:
    walls, maze = (build(name, 0.0) for name in HARD_SCENES)
    assert (len(walls), len(maze)) == (13, 9)
    # Theirs (0.15, -0.475, yaw 0) is ours (0.475, 0.15, yaw 90 deg).
    assert walls[0].pose == pytest.approx((0.475, 0.15, math.pi / 2))
    # Theirs (-0.15, -0.375, 45 deg), 40 cm long, is ours (0.375, -0.15, 135 deg).
    assert maze[7].pose == pytest.approx((0.375, -0.15, 0.75 * math.pi))
    assert maze[7].size[0] == pytest.approx(0.40)


@pytest.mark.parametrize(
    ("name", "difficulty", "gap"),
    [
        # Centres are 10 and 15 cm apart: hypot(0.10 - 0.06, 0.15 - length).
        ("diagonal_walls", 0.0, 0.0640),
        ("diagonal_walls", 1.0, 0.0640),
        ("diagonal_walls_wide", 0.0, 0.0985),
        ("diagonal_walls_wide", 1.0, 0.0806),
    ],
)
def test_the_walls_leave_a_way_for_the_small_cube_where_they_cross(
    name: str, difficulty: float, gap: float
) -> None:
    walls, cube = build(name, difficulty), get_object("small_cube")
    assert free_gap(walls[3], walls[0]) == pytest.approx(gap, abs=1e-3)
    assert gap > 2 * cube.inscribed_radius
    assert (gap > 2 * cube.radius) == (name in HARD_WIDE_SCENES)


def test_tuning_layouts_are_the_hard_ones_turned_or_mirrored_and_others() -> None:
    walls, turned = build("diagonal_walls", 0.0), build("diagonal_walls_turned", 0.0)
    # The crossing stays; 15 cm to the left of it is now 15 cm nearer to the robot.
    assert turned[3].pose == pytest.approx((*walls[3].pose[:2], 0.0))
    assert walls[0].pose[:2] == pytest.approx((0.475, 0.15))
    assert turned[0].pose[:2] == pytest.approx((0.425, -0.10))
    assert free_gap(turned[3], turned[0]) == pytest.approx(free_gap(walls[3], walls[0]), abs=1e-4)
    maze, mirrored = build("maze", 0.0), build("maze_mirrored", 0.0)
    for a, b in zip(maze, mirrored, strict=True):
        assert b.pose == pytest.approx((a.pose[0], -a.pose[1], -a.pose[2]))
    assert not {*HARD_TUNING_SCENES} & {*HARD_SCENES, *HARD_WIDE_SCENES}


def test_narrow_gaps_let_object_and_gripper_through() -> None:
    gaps = [free_gap(*build("narrow_gap", seed % 3 / 2, seed=seed)) for seed in range(300)]
    assert 0.08 - 1e-6 <= min(gaps) < 0.085
    assert 0.115 < max(gaps) <= 0.12 + 1e-6
    assert 2 * max(TOOLS["2f85"].tip_half_extents) < min(gaps)


def test_no_bar_stands_where_the_arm_does() -> None:
    for name in ("narrow_gap", "random_bars"):
        for seed in range(200):
            for bar in build(name, 1.0, seed=seed):
                (length, width, _), (x, _, yaw) = bar.size, bar.pose
                reach = (abs(math.cos(yaw)) * length + abs(math.sin(yaw)) * width) / 2
                assert x - reach >= 0.17


def test_clutter_does_not_overlap_and_is_different_every_time() -> None:
    cubes = build("random_clutter", 0.0)
    assert len(cubes) == 10
    for i, a in enumerate(cubes):
        for b in cubes[:i]:
            assert free_gap(a, b) > 0.02 - 1e-9
    assert cubes != build("random_clutter", 0.0, seed=1)


def test_families_are_functions_of_generator_and_difficulty_alone() -> None:
    training = ("narrow_gap", "random_bars")
    for name in (*OBSTACLE_SCENES, *HARD_SCENES, *HARD_TUNING_SCENES, *training, "free"):
        assert build(name, 0.3, seed=5) == build(name, 0.3, seed=5)


def one_cube(rng: np.random.Generator, difficulty: float) -> list[Obstacle]:
    return [Obstacle((0.05, 0.05, 0.05), (0.475, 0.0, difficulty))]


def test_a_function_is_found_again_by_the_name_it_is_recorded_under() -> None:
    name, found = get_scene(one_cube)
    assert name == f"{__name__}:one_cube"
    assert found is one_cube
    assert get_scene(name) == (name, one_cube)
