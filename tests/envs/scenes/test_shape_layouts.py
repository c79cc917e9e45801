import math
from dataclasses import replace

import numpy as np
import pytest

from modpush.envs.scenes.objects import OBJECTS
from modpush.envs.scenes.obstacle import Obstacle
from modpush.envs.scenes.rectangles import (
    crosses_rectangle,
    obstacle_distance,
    rectangles,
    turned_rectangles,
)
from modpush.envs.scenes.sampling import sample_scenario
from modpush.envs.scenes.scenario import ScenarioConfig
from modpush.envs.scenes.shape_layouts import SHAPE_SCENES


@pytest.mark.parametrize("difficulty", [0.0, 1.0])
def test_the_boxes_of_a_circle_fill_it_within_3_mm(difficulty: float) -> None:
    scale = 0.8 + 0.4 * difficulty
    for seed in range(10):
        boxes = SHAPE_SCENES["one_circle"](np.random.default_rng(seed), difficulty)
        centre = np.array(boxes[0].pose[:2])
        length, width, _ = boxes[0].size  # of half of it the diagonal is the radius
        radius = math.hypot(length, width) / 2
        assert 0.04 * scale <= radius <= 0.07 * scale
        angles = np.linspace(0, 2 * math.pi, 721)
        ring = np.stack([np.cos(angles), np.sin(angles)], -1)
        assert (obstacle_distance(centre + (radius - 0.003) * ring, boxes) == 0).all()
        assert (obstacle_distance(centre + (radius + 1e-9) * ring, boxes) > 0).all()


def test_the_legs_of_an_l_end_at_its_outer_corner() -> None:
    for seed in range(10):
        first, second = SHAPE_SCENES["one_l"](np.random.default_rng(seed), 0.5)
        corners = []
        for box, turn in (
            (first, -1),
            (second, 1),
        ):  # the outer corner is at the left end's other side
            (length, width, _), (x, y, yaw) = box.size, box.pose
            c, s = math.cos(yaw), math.sin(yaw)
            u, v = -length / 2, turn * width / 2
            corners.append((x + c * u - s * v, y + s * u + c * v))
        assert corners[0] == pytest.approx(corners[1], abs=1e-9)
        assert math.cos(first.pose[2] - second.pose[2]) == pytest.approx(0, abs=1e-9)


def test_two_rectangles_do_not_overlap_and_stand_near_each_other() -> None:
    for seed in range(30):
        first, second = SHAPE_SCENES["two_rectangles"](np.random.default_rng(seed), 1.0)
        (length, width, _), (x, y, yaw) = first.size, first.pose
        u, v = np.meshgrid(np.linspace(-0.5, 0.5, 41) * length, np.linspace(-0.5, 0.5, 41) * width)
        c, s = math.cos(yaw), math.sin(yaw)
        points = np.stack([x + c * u - s * v, y + s * u + c * v], -1)
        assert 0 < obstacle_distance(points, [second]).min() < 1.2 * 0.14 + 0.2


def test_ways_through_a_rectangle_are_those_with_a_point_inside() -> None:
    rng = np.random.default_rng(0)
    crossed = 0
    for _ in range(500):
        boxes = SHAPE_SCENES["one_t"](rng, rng.uniform())
        start, end = rng.uniform((0.2, -0.35), (0.75, 0.35), (2, 2))
        points = start + np.linspace(0, 1, 4001)[:, None] * (end - start)
        distance = obstacle_distance(points, boxes).min()
        if distance == 0 or distance > 2e-4:  # nothing between the points
            found = crosses_rectangle(start, end, turned_rectangles(rectangles(boxes)))
            assert found == (distance == 0)
            crossed += found
    assert 100 < crossed < 400


@pytest.mark.parametrize("scene", SHAPE_SCENES)
@pytest.mark.parametrize("item", OBJECTS)
def test_an_obstacle_stands_between_start_and_goal_where_asked_for(scene: str, item: str) -> None:
    for between in (True, False):
        config = ScenarioConfig(
            scene=scene, pushed_object=item, distance=(0.4, 0.6), obstacle_between=between
        )
        drawn = [sample_scenario(np.random.default_rng(k), config) for k in range(12)]
        through = [
            crosses_rectangle(
                np.array(s.object_pose[:2]),
                np.array(s.goal_position),
                turned_rectangles(rectangles(s.obstacles)),
            )
            for s in drawn
        ]
        assert all(through) == between


def test_scenes_without_obstacles_are_drawn_beside_those_with_one_between() -> None:
    config = ScenarioConfig(scene=("free", "one_circle"), distance=0.5, obstacle_between=True)
    drawn = [sample_scenario(np.random.default_rng(k), config) for k in range(12)]
    assert {s.scene for s in drawn} == {"free", "one_circle"}
    alone = ScenarioConfig(scene="free", distance=0.5)
    asked = replace(alone, obstacle_between=True)
    first, second = (sample_scenario(np.random.default_rng(0), c) for c in (alone, asked))
    assert first == second


def beside_the_workspace(rng: np.random.Generator, difficulty: float) -> list[Obstacle]:
    return [Obstacle((0.05, 0.05, 0.06), (0.6, 0.45, 0.0))]


def test_a_scene_whose_obstacle_is_never_between_says_so() -> None:
    config = ScenarioConfig(scene=beside_the_workspace, obstacle_between=True)
    with pytest.raises(ValueError, match=r"no obstacle between start and goal: \d+"):
        sample_scenario(np.random.default_rng(0), config)


def test_the_moving_bar_goes_to_and_fro_between_the_edges_of_the_workspace() -> None:
    first = set()
    for seed in range(20):
        (bar,) = SHAPE_SCENES["moving_bar"](np.random.default_rng(seed), 0.5)
        (still,) = SHAPE_SCENES["one_rectangle"](np.random.default_rng(seed), 0.5)
        assert bar.standing(0.0) == still
        x = bar.pose[0]
        places = bar.at(np.arange(0.0, 20.0, 0.01))
        assert (places[:, 0] == x).all()
        assert places[:, 1].min() == pytest.approx(-0.35, abs=1e-3)
        assert places[:, 1].max() == pytest.approx(0.35, abs=1e-3)
        assert np.abs(places[:, 3]) == pytest.approx(np.full(2000, 0.1))
        first.add(float(places[0, 3]))
    assert first == {-0.1, 0.1}
