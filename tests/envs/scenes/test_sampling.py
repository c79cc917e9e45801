import json
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import kstest

from modpush.envs.scenes.layouts import SCENES, TIGHT_SCENES, get_scene
from modpush.envs.scenes.objects import OBJECTS, PAPER_OBJECTS, PushedObject
from modpush.envs.scenes.obstacle import Obstacle
from modpush.envs.scenes.rectangles import (
    GRID_LOW,
    GRID_SIDE,
    obstacle_distance,
    passable_cells,
    rectangles,
    turned_rectangles,
)
from modpush.envs.scenes.sampling import sample_scenario
from modpush.envs.scenes.scenario import ScenarioConfig
from modpush.geometry.shapes import box

GOLDEN = json.loads((Path(__file__).parent / "golden_scenarios.json").read_text())
"""Drawn with the distance first: two episodes of each family, then twenty of three families at once."""


def assert_same(drawn, golden) -> None:
    """Equal but for the last bits of sine and cosine, which differ between machines."""
    if isinstance(golden, dict):
        assert drawn.keys() == golden.keys()
        for key in golden:
            assert_same(drawn[key], golden[key])
    elif isinstance(golden, list):
        assert len(drawn) == len(golden)
        for one, other in zip(drawn, golden, strict=True):
            assert_same(one, other)
    elif isinstance(golden, float):
        assert drawn == pytest.approx(golden, abs=1e-14)
    else:
        assert drawn == golden


def test_a_seed_gives_the_scenario_that_it_always_gave() -> None:
    names = list(PAPER_OBJECTS)
    drawn = [
        (
            np.random.default_rng([k, j]),
            ScenarioConfig(
                scene=scene, pushed_object=names[(k + j) % 4], randomize_dynamics=j == 1
            ),
        )
        for k, scene in enumerate(list(SCENES)[:10])
        for j in range(2)
    ]
    several = ScenarioConfig(
        scene=["free", "slot", "maze_wide"],
        pushed_object=names,
        difficulty=0.5,
        distance=(0.3, 0.5),
    )
    drawn += [(np.random.default_rng([99, j]), several) for j in range(20)]
    for (rng, config), golden in zip(drawn, GOLDEN, strict=True):
        assert_same(json.loads(json.dumps(sample_scenario(rng, config).to_dict())), golden)


@pytest.mark.parametrize("cell", [0.01, 0.0025])
@pytest.mark.parametrize("scene", sorted({*SCENES, *TIGHT_SCENES} - {"free"}))
def test_passable_cells_are_those_far_enough_from_every_obstacle(scene: str, cell: float) -> None:
    rng = np.random.default_rng(1)
    side = round(GRID_SIDE / cell)
    centers = np.array(GRID_LOW) + (np.stack(np.indices((side, side)), -1) + 0.5) * cell
    for _ in range(5):
        obstacles = get_scene(scene)[1](rng, rng.uniform())
        radius, low = rng.uniform(0.02, 0.06), rng.normal((0.2, -0.4), 0.01)
        high = low + rng.uniform(0.3, 0.8, 2)
        expected = (obstacle_distance(centers, obstacles) > radius) & (
            (centers >= low) & (centers <= high)
        ).all(-1)
        turned = turned_rectangles(rectangles(obstacles))
        found = passable_cells(turned, radius, low, high, cell)
        np.testing.assert_array_equal(found, expected)


def test_a_small_tool_may_stand_where_a_large_one_may_not() -> None:
    config = ScenarioConfig(pushed_object="large_cube", tool_distance=(0.062, 0.064))
    rod = sample_scenario(np.random.default_rng(0), config, tool="rod")
    assert 0.062 <= math.dist(rod.object_pose[:2], rod.tool_pose[:2]) <= 0.064
    with pytest.raises(ValueError, match="tool touches the object"):
        sample_scenario(np.random.default_rng(0), config, tool="2f85")


def test_the_tool_may_start_straight_behind_the_object() -> None:
    for seed in range(20):
        s, other = (
            sample_scenario(np.random.default_rng(seed), ScenarioConfig(tool_start=start))
            for start in ("behind", "any")
        )
        x, y = np.subtract(s.goal_position, s.object_pose[:2])
        heading = math.atan2(y, x)
        assert s.tool_pose[0] == pytest.approx(s.object_pose[0] - 0.09 * math.cos(heading))
        assert s.tool_pose[1] == pytest.approx(s.object_pose[1] - 0.09 * math.sin(heading))
        assert math.cos(s.tool_pose[2] - heading) == pytest.approx(0, abs=1e-9)
        assert 0.16 <= math.hypot(*s.tool_pose[:2]) <= 0.885
        if s.goal_position == other.goal_position:
            assert s.object_pose == other.object_pose
            assert s.dynamics == other.dynamics


def test_a_start_with_an_obstacle_behind_the_object_is_drawn_again() -> None:
    """Between two walls, 40 cm apart: the gripper's circle of 3.4 cm keeps 5 mm from them."""

    def walls(rng: np.random.Generator, difficulty: float) -> list[Obstacle]:
        return [Obstacle((0.8, 0.04, 0.06), (0.475, y, 0.0)) for y in (-0.22, 0.22)]

    again = 0
    for seed in range(60):
        s, other = (
            sample_scenario(
                np.random.default_rng(seed),
                ScenarioConfig(scene=walls, distance=0.2, tool_start=start),
            )
            for start in ("behind", "any")
        )
        assert obstacle_distance(np.array(s.tool_pose[:2]), s.obstacles) >= 0.0338 + 0.005
        again += s.goal_position != other.goal_position
    assert 0 < again < 30


def test_the_wide_side_may_be_nearer_than_the_circumscribed_circles() -> None:
    """Of a cube of 10 cm the corners reach 7.07 cm, the tool's side 1.1 cm: 8 mm are left of 9 cm.
    Of one of 12 cm they reach 8.5 cm, and with them ahead nothing is left."""
    cube = PushedObject(name="ten", parts=(box(0.10, 0.10, 0.05),))
    drawn = ScenarioConfig(pushed_object=cube, tool_start="behind")
    for seed in range(10):
        sample_scenario(np.random.default_rng(seed), drawn)
    cube = PushedObject(name="twelve", parts=(box(0.12, 0.12, 0.05),))
    drawn = ScenarioConfig(pushed_object=cube, tool_start="behind")
    for seed in range(10):
        s = sample_scenario(np.random.default_rng(seed), drawn)
        to_tool = np.subtract(s.tool_pose[:2], s.object_pose[:2]) / 0.09
        turn = math.atan2(to_tool[1], to_tool[0]) - s.object_pose[2]
        assert 0.06 * (abs(math.cos(turn)) + abs(math.sin(turn))) <= 0.09 - 0.011 - 0.002 + 1e-9
    cube = PushedObject(name="sixteen", parts=(box(0.16, 0.16, 0.05),))
    drawn = ScenarioConfig(pushed_object=cube, tool_start="behind", tool_distance=(0.16, 0.18))
    with pytest.raises(ValueError, match="place of the tool taken"):
        sample_scenario(np.random.default_rng(0), drawn)


def config_of(scene: str) -> ScenarioConfig:
    circle = "inscribed" if scene in TIGHT_SCENES else "circumscribed"
    return ScenarioConfig(scene=scene, pushed_object="small_cube", path_inflation=circle)


@pytest.mark.parametrize("scene", sorted({*SCENES, *TIGHT_SCENES}))
def test_starts_and_goals_keep_the_spec(scene) -> None:
    config = config_of(scene)
    rng = np.random.default_rng(0)
    for _ in range(30):
        s = sample_scenario(rng, config)
        start, goal, tool = (np.array(p[:2]) for p in (s.object_pose, s.goal_position, s.tool_pose))
        assert 0.2 <= np.linalg.norm(goal - start) <= 0.6
        assert 0.08 <= np.linalg.norm(tool - start) <= 0.14
        for point, reach in ((start, 0.80), (goal, 0.82)):
            assert (point >= config.low).all()
            assert (point <= config.high).all()
            assert np.linalg.norm(point) <= reach
            # Surface to surface: the circumscribed circle keeps 6 cm, so the square does.
            clear = obstacle_distance(point, s.obstacles) - OBJECTS["small_cube"].radius
            assert clear >= 0.06 - 1e-9
        assert obstacle_distance(tool, s.obstacles) > np.hypot(0.032, 0.011)


def test_goals_lie_in_every_direction_and_at_every_distance() -> None:
    rng = np.random.default_rng(0)
    drawn = [sample_scenario(rng, ScenarioConfig(distance=(0.06, 0.08))) for _ in range(300)]
    way = np.array([np.subtract(s.goal_position, s.object_pose[:2]) for s in drawn])
    quadrant = (way[:, 0] > 0) * 2 + (way[:, 1] > 0)
    assert np.bincount(quadrant, minlength=4).min() > 50
    assert np.histogram(np.linalg.norm(way, axis=1), 4, (0.06, 0.08))[0].min() > 40


@pytest.mark.parametrize("scene", [*SCENES, *TIGHT_SCENES])
def test_distances_are_uniform_in_every_family(scene: str) -> None:
    config = config_of(scene)
    drawn = [sample_scenario(np.random.default_rng([5, i]), config) for i in range(100)]
    distance = [math.dist(s.goal_position, s.object_pose[:2]) for s in drawn]
    assert kstest(distance, "uniform", (0.2, 0.4)).pvalue > 0.01


def test_no_scenario_without_a_path() -> None:
    def wall(rng: np.random.Generator, difficulty: float) -> list[Obstacle]:
        return [Obstacle((2.0, 0.06, 0.06), (0.475, 0.0, np.pi / 2))]

    rng = np.random.default_rng(0)
    for _ in range(30):
        s = sample_scenario(rng, ScenarioConfig(scene=wall))
        assert (s.object_pose[0] > 0.475) == (s.goal_position[0] > 0.475)


def test_no_scenario_whose_way_leads_out_of_bounds() -> None:
    """Its ends leave 7 cm to the image's edge, but only outside of the workspace."""

    def wall(rng: np.random.Generator, difficulty: float) -> list[Obstacle]:
        return [Obstacle((0.76, 0.06, 0.06), (0.475, 0.0, np.pi / 2))]

    def sides(path_margin: float) -> set[bool]:
        rng, config = np.random.default_rng(0), ScenarioConfig(scene=wall, path_margin=path_margin)
        drawn = [sample_scenario(rng, config) for _ in range(30)]
        return {(s.object_pose[0] > 0.475) == (s.goal_position[0] > 0.475) for s in drawn}

    assert sides(path_margin=0.04) == {True}
    assert sides(path_margin=0.10) == {True, False}


def test_passages_are_open_to_the_circle_that_is_asked_for() -> None:
    """A wall whose gap of 6.4 cm lets the cube's inscribed circle through, not the other one."""

    def wall(rng: np.random.Generator, difficulty: float) -> list[Obstacle]:
        x, y = 0.475, 0.032 + 0.4
        return [Obstacle((0.8, 0.06, 0.06), (x, side * y, np.pi / 2)) for side in (-1, 1)]

    def sides(circle: str) -> set[bool]:
        config = ScenarioConfig(scene=wall, path_inflation=circle)
        drawn = [sample_scenario(np.random.default_rng([0, i]), config) for i in range(30)]
        return {(s.object_pose[0] > 0.475) == (s.goal_position[0] > 0.475) for s in drawn}

    assert sides("circumscribed") == {True}
    assert sides("inscribed") == {True, False}


def test_a_tight_family_says_what_it_needs() -> None:
    with pytest.raises(ValueError, match=r"In 'diagonal_walls' a path needs path_inflation='inscr"):
        sample_scenario(
            np.random.default_rng(0), ScenarioConfig(scene="diagonal_walls", distance=0.6)
        )
    assert get_scene("diagonal_walls")[0] == "diagonal_walls"


def test_an_impossible_scene_says_which_condition_failed() -> None:
    def full(rng: np.random.Generator, difficulty: float) -> list[Obstacle]:
        return [Obstacle((0.7, 2.0, 0.06), (0.56, 0.0, 0.0))]

    with pytest.raises(
        ValueError, match=r"no start .* m from a goal found in scene 'full'.*start too close"
    ):
        sample_scenario(np.random.default_rng(0), ScenarioConfig(scene=full))


def test_another_distance_is_drawn_where_a_layout_has_no_start_at_the_first() -> None:
    """`random_1` in the diagonals has no start 0.5 m from a goal; this ended a run."""
    config = ScenarioConfig(
        scene="diagonal_walls",
        pushed_object="random_1",
        path_inflation="inscribed",
        distance=(0.1, 0.6),
    )
    for seed in range(8):
        start = sample_scenario(np.random.default_rng(seed), config)
        assert 0.1 <= np.linalg.norm(np.subtract(start.goal_position, start.object_pose[:2])) <= 0.6


def test_dynamics_are_drawn_only_when_asked_for() -> None:
    rng = np.random.default_rng(0)
    fixed = {sample_scenario(rng, ScenarioConfig()).dynamics for _ in range(5)}
    assert len(fixed) == 1
    config = ScenarioConfig(randomize_dynamics=True)
    drawn = [sample_scenario(rng, config).dynamics for _ in range(200)]
    masses = np.array([d.mass for d in drawn])
    assert (masses >= config.mass[0]).all()
    assert (masses <= config.mass[1]).all()
    assert np.median(masses) == pytest.approx(np.sqrt(0.2 * 2.0), rel=0.3)  # log-uniform
    assert max(abs(c) for d in drawn for c in d.center_of_mass) <= config.center_of_mass
