from dataclasses import replace

import numpy as np
import pytest
from torchrl.envs import TransformedEnv

from modpush.envs import Obstacle, PushEnv, Scenario
from modpush.envs.scenes.objects import get_object
from modpush.envs.scenes.rectangles import obstacle_distance
from modpush.evaluation.sets import load_set
from modpush.evaluation.shortest import blocked_cells, shortest_path
from modpush.planners import LazyThetaStar, OccupancyGrid, PlannerSubgoals


def scenario(*obstacles: Obstacle) -> Scenario:
    return Scenario(
        scene="bar_along",
        difficulty=0.0,
        obstacles=obstacles,
        pushed_object="small_cylinder",
        object_pose=(0.475, 0.2, 0.0),
        goal_position=(0.475, -0.2),
        tool_pose=(0.475, 0.3, 0.0),
    )


def test_nothing_in_the_way_is_the_straight_line() -> None:
    corners, length = shortest_path(scenario())
    assert length == pytest.approx(0.4)
    np.testing.assert_allclose(corners, [[0.475, 0.2], [0.475, -0.2]])


def test_round_a_bar_by_hand() -> None:
    # A wall 0.2 m long and 0.06 m wide across the way, inflated by a disc of 3 cm. The taut string
    # touches the discs at both corners: with a = 0.2 - 0.03 aside and b = 0.1 up to a corner,
    # d = hypot(a, b), tangent sqrt(d^2 - r^2), and arcs on the discs joined by the 0.06 m between.
    wall = Obstacle((0.2, 0.06, 0.06), (0.475, 0.0, 0.0))
    r, a, b = 0.03, 0.17, 0.1
    d = np.hypot(a, b)
    tangent = np.sqrt(d**2 - r**2)
    rise = np.arctan2(b, a) + np.arcsin(r / d)  # direction of the tangent against the way across
    expected = 2 * (tangent + r * rise) + 0.06
    _, length = shortest_path(scenario(wall))
    assert length == pytest.approx(expected, rel=0.01)  # cells of 3.6 mm


def test_it_stays_where_an_episode_does_not_end() -> None:
    # A wall from the image's right edge to y = 0.38. The cylinder of radius 3 cm passes its end at
    # y = 0.41, where the image shows the table but an episode has ended.
    length = 0.38 + 0.60
    wall = Obstacle((length, 0.06, 0.06), (0.475, 0.38 - length / 2, np.pi / 2))
    ends = {"object_pose": (0.35, 0.30, 0.0), "goal_position": (0.60, 0.30)}
    corners, shortest = shortest_path(replace(scenario(wall), **ends))
    assert len(corners) == 2  # there is none, so the straight line
    wall = replace(
        wall, size=(length - 0.02, 0.06, 0.06), pose=(0.475, 0.37 - length / 2, np.pi / 2)
    )
    corners, shortest = shortest_path(replace(scenario(wall), **ends))
    assert len(corners) > 2
    assert shortest > 0.25
    assert 0.38 < corners[:, 1].max() <= 0.40 + 0.002


def test_by_the_inscribed_circle_a_way_leads_through_a_narrower_gap() -> None:
    wall = [Obstacle((1.0, 0.06, 0.06), (0.475 + side * 0.532, 0.0, 0.0)) for side in (-1, 1)]
    cube = replace(scenario(*wall), pushed_object="small_cube", object_pose=(0.475, 0.2, 0.5))
    corners, length = shortest_path(cube, inflation="inscribed")
    assert length == pytest.approx(0.4, rel=1e-3)
    blocked = {
        circle: blocked_cells(cube, inflation=circle) for circle in ("inscribed", "circumscribed")
    }
    assert (blocked["circumscribed"] & ~blocked["inscribed"]).any()
    assert not (blocked["inscribed"] & ~blocked["circumscribed"]).any()
    assert len(corners) == 2


def test_every_episode_of_the_hard_sets_has_a_way() -> None:
    planner = LazyThetaStar()
    for name in ("smoke", "hard/small_cube", "hard_wide/small_cube", "obstacles/fragment"):
        episodes = load_set(name).first(50)
        for s in episodes:
            circle = episodes.conditions.inflation
            corners, length = shortest_path(s, planner, inflation=circle)
            straight = np.hypot(*np.subtract(s.object_pose[:2], s.goal_position))
            assert length >= straight - 1e-9
            # Where a straight line is answered, it must be one that touches nothing.
            if len(corners) == 2:
                points = np.linspace(*corners, 100)
                radius = get_object(s.pushed_object).radius_of(circle)
                assert (obstacle_distance(points, s.obstacles) > radius - 0.005).all()


def test_it_is_what_the_planner_says_at_reset() -> None:
    smoke = load_set("smoke")
    chosen = [smoke.scenarios[n] for n in (3, 8, 9, 18)]  # slot, hard scenes; three objects
    env = TransformedEnv(
        PushEnv(len(chosen), pushed_object=smoke.objects),
        OccupancyGrid(object_radius_key="object_radius"),
    )
    env.append_transform(PlannerSubgoals(LazyThetaStar()))
    said = env.reset(scenarios=chosen)["path_length"].flatten().tolist()
    env.close()
    np.testing.assert_allclose(said, [shortest_path(s)[1] for s in chosen], rtol=0.02)
