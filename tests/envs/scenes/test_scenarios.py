import json

import numpy as np
import pytest

from modpush.envs.scenes.layouts import SCENES, Obstacle, obstacle_distance
from modpush.envs.scenes.objects import OBJECTS
from modpush.envs.scenes.scenario import Scenario, ScenarioConfig, sample_scenario


@pytest.mark.parametrize("scene", sorted(SCENES))
def test_starts_and_goals_keep_the_spec(scene) -> None:
    config = ScenarioConfig(scene=scene, pushed_object="small_cube")
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


def test_an_impossible_scene_says_which_condition_failed() -> None:
    def full(rng: np.random.Generator, difficulty: float) -> list[Obstacle]:
        return [Obstacle((2.0, 2.0, 0.06), (0.5, 0.0, 0.0))]

    with pytest.raises(ValueError, match=r"no start found in scene 'full'.*start too close"):
        sample_scenario(np.random.default_rng(0), ScenarioConfig(scene=full))


def test_too_many_obstacles_are_refused() -> None:
    def many(rng: np.random.Generator, difficulty: float) -> list[Obstacle]:
        return [Obstacle((0.05, 0.05, 0.05), (0.5, 0.0, 0.0))] * 30

    with pytest.raises(ValueError, match="'many' placed 30 obstacles, at most 24 fit"):
        sample_scenario(np.random.default_rng(0), ScenarioConfig(scene=many))


def test_one_seed_one_scenario_and_it_survives_json() -> None:
    config = ScenarioConfig(scene=tuple(SCENES), pushed_object=tuple(OBJECTS))
    first, second = (sample_scenario(np.random.default_rng(7), config) for _ in range(2))
    assert first == second
    assert Scenario.from_dict(json.loads(json.dumps(first.to_dict()))) == first


def test_a_scenario_of_other_fields_is_refused() -> None:
    data = sample_scenario(np.random.default_rng(0), ScenarioConfig()).to_dict()
    data["gaol"] = data.pop("goal_position")
    with pytest.raises(ValueError, match=r"missing \['goal_position'\], unknown \['gaol'\]"):
        Scenario.from_dict(data)


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


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"difficulty": 1.5}, r"difficulty must be a range within \[0, 1\], got \(1.5, 1.5\)"),
        ({"distance": (0.6, 0.2)}, r"distance must be a range"),
        ({"scene": ()}, "scene is empty"),
        ({"scene": "nowhere"}, "no family 'nowhere'"),
        ({"pushed_object": ("small_cube", "egg")}, "no object 'egg'"),
        ({"low": (1.0, 0.0)}, "low must be < high"),
    ],
)
def test_a_bad_config_fails_at_once(fields, message) -> None:
    with pytest.raises(ValueError, match=message):
        ScenarioConfig(**fields)
