"""Targets by hand: the look-ahead and its fallbacks, and room for the tool."""

import math

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from modpush.agents.corridor.config import CorridorConfig
from modpush.agents.corridor.scene import least_clearance, obstacle_distance
from modpush.agents.corridor.target import Limits, View, choose_targets, look_ahead, turn_target
from modpush.geometry import Camera
from tests.agents.corridor.corridor_scenes import plan, scene, wall

LIMITS = (5.0, 2.0, 1.0)


def ahead(
    blocked,
    path,
    position,
    tool=(0.0, 0.0),
    previous=(9.0, 9.0),
    first=False,
    relative=False,
    limits=LIMITS,
    behind=4.0,
    room=0.0,
    step=5,
):
    spots = (np.asarray(spot, float) for spot in (path, position, tool, previous))
    view = View(obstacle_distance(blocked), *spots, first)
    outer, inner, touch = limits
    return look_ahead(view, Limits(outer, inner, touch, room, behind, relative, step))


def test_without_obstacles_the_target_is_the_goal():
    path = np.linspace((5, 5), (50, 30), 40)
    assert ahead(np.zeros((40, 60), bool), path, (5, 5)) == (50, 30)


def test_the_target_is_the_furthest_visible_point_clear_of_the_outer_zone():
    path = plan(wall(), (5, 5), (5, 35))
    target = ahead(wall(), path, (5, 5))
    distance = obstacle_distance(wall())
    assert least_clearance(distance, 5.0, 5.0, *target) > 5
    index = np.abs(path - target).sum(1).argmin()
    for further in path[index + 2 :: 2]:
        assert least_clearance(distance, 5.0, 5.0, *further) <= 5
    assert index > 10


def test_the_first_fallback_is_the_furthest_point_clear_of_the_inner_zone():
    # The object stands 4 cells from the wall: nothing is clear of the outer zone (5) from there.
    path = np.linspace((10, 14), (58, 14), 49)
    assert ahead(wall(), path, (10, 14), tool=(2, 14)) == (58, 14)
    # The pushing position is (6, 14); a tool across the wall does not reach it, the path
    # is not clear of the outer zone there, so it falls back on the furthest clear of the inner one.
    assert ahead(wall(), path, (10, 14), tool=(6, 30)) == (58, 14)
    # 2 cells from the wall nothing is clear of the inner zone, but there is room for the object.
    path = np.linspace((10, 16), (58, 16), 49)
    assert ahead(wall(), path, (10, 16), tool=(2, 16)) == (58, 16)
    # If the tool does not reach the pushing position: the previous target.
    assert ahead(wall(), path, (10, 16), tool=(6, 30)) == (9, 9)


def test_the_second_fallback_is_a_point_ahead_on_a_clear_path():
    # The object touches a wall at the image's rim, the tool stands outside; the path is clear.
    blocked = wall(rows=slice(0, 2))
    path = np.linspace((10, 10), (58, 10), 49)
    assert ahead(blocked, path, (12, 2), tool=(12, -5)) == (17, 10)
    assert ahead(blocked, path, (12, 2), tool=(12, -5), step=9) == (21, 10)


def test_relative_limits_let_an_object_at_a_wall_slide_along_it():
    path = np.linspace((10, 16), (58, 16), 49)
    faithful = ahead(wall(), path, (10, 17), tool=(6, 30))
    assert faithful == (9, 9)  # no visible point: the target before
    target = ahead(wall(), path, (10, 16), tool=(2, 16), relative=True)
    assert target == (58, 16)


def test_a_smaller_touch_radius_opens_a_narrower_gap():
    camera, config = Camera(), CorridorConfig(contact_distance=0.0, rules="faithful")
    blocked = np.zeros((camera.height, camera.width), bool)
    blocked[120:136] = True
    blocked[:, 119:137] = False  # a gap of 6.4 cm for a cube of 5 cm, right ahead of it
    start, goal = (camera.unproject(torch.tensor([[128.0, v]])) for v in (141.0, 90.0))
    path = torch.linspace(0, 1, 64)[None, :, None] * (goal - start)[:, None] + start[:, None]
    previous = start + 0.01
    state = TensorDict({"path": path, "target": previous, "started": torch.tensor([[True]])}, [1])
    tool = start - torch.tensor([config.behind_distance, 0.0])
    targets = []
    for touch in (math.inf, 0.025):
        here = scene([obstacle_distance(blocked)], camera, start, tool, radius=0.0354)
        here = here._replace(goal=goal, touch_radius=torch.tensor([touch]))
        targets.append(choose_targets(here, state, config))
    torch.testing.assert_close(targets[0], previous)  # no visible point: the target before
    torch.testing.assert_close(targets[1], goal)


def test_relative_limits_ask_for_room_behind_the_object():
    # At a dead end the goal is visible, but the pushing position lies in the wall.
    blocked = wall(rows=slice(18, 22), columns=slice(0, 60))
    path = np.linspace((30, 15), (30, 2), 14)
    assert ahead(blocked, path, (30, 15), tool=(30, 17), relative=True, room=0.0) == (30, 10)
    path = np.linspace((30, 15), (50, 15), 21)
    assert ahead(blocked, path, (30, 15), tool=(20, 15), relative=True) == (50, 15)


def test_in_the_first_step_the_pushing_position_must_be_free():
    # Pushing straight up from (10, 14) needs the tool at (10, 18), in the wall.
    path = np.linspace((10, 14), (10, 2), 13)
    limits = (1.0, 0.5, 0.2)
    assert ahead(wall(), path, (10, 14), first=False, limits=limits) == (10, 2)
    assert ahead(wall(), path, (10, 14), first=True, limits=limits) == (10, 9)


def test_a_target_is_turned_by_the_smallest_angle_that_makes_room():
    # 6 cells above the wall, to be pushed straight up: the tool would stand 5 further down, 1 off
    # the wall, and needs 3. At 45 degrees it stands 5 cos 45 = 3.5 down, 2.5 off; at 60 degrees
    # 2.5 down, 3.5 off.
    distance = obstacle_distance(wall())
    position, target = np.array([20.0, 12.0]), np.array([20.0, 2.0])
    u, v = turn_target(distance, position, target, 5.0, 3.0, 4.0, 2.0)
    assert np.hypot(u - 20, v - 12) == pytest.approx(10)
    assert abs(np.degrees(np.arctan2(u - 20, 12 - v))) == pytest.approx(60)
    # Away from walls nothing is turned; nor where no turn makes room.
    assert turn_target(distance, position, target, 3.0, 3.0, 4.0, 2.0) == pytest.approx((20, 2))
    assert turn_target(distance, position, target, 5.0, 30.0, 4.0, 2.0) == pytest.approx((20, 2))


def test_a_turned_target_does_not_lead_into_an_obstacle():
    distance = obstacle_distance(wall())
    # To be pushed down into the wall: turned until 4 cells ahead keep 2 cells off it.
    position, target = np.array([20.0, 14.0]), np.array([20.0, 24.0])
    _, v = turn_target(distance, position, target, 5.0, 1.0, 4.0, 2.0)
    ahead = 14 + 0.4 * (v - 14)
    assert distance[round(ahead), 20] >= 2
    assert ahead > 14
