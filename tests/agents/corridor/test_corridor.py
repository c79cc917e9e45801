"""Corridor geometry by hand: distances, costs, paths, look-ahead."""

import math

import numpy as np
import pytest
import scipy.ndimage as ndi
import torch
from tensordict import TensorDict

from modpush.agents.corridor.clearance import (
    away_from_obstacles,
    least_clearance,
    object_clearance,
    tool_repulsion,
)
from modpush.agents.corridor.config import CorridorConfig
from modpush.agents.corridor.corridor_path import corridor_cost, least_cost_path
from modpush.agents.corridor.look_ahead import Limits, View, look_ahead
from modpush.agents.corridor.obstacle_distance import ObstacleDistances, obstacle_distance
from modpush.agents.corridor.rules import RULES
from modpush.agents.corridor.scene import CorridorScene
from modpush.agents.corridor.targets import choose_targets
from modpush.agents.corridor.tool_path import next_tool_position
from modpush.agents.corridor.turn_target import RoomNeeded, turn_target
from modpush.geometry import Camera
from modpush.planners import LazyThetaStar


def wall(height=40, width=60, rows=slice(18, 22), columns=slice(0, 40)):
    """A wall from the left with a gap at its right."""
    blocked = np.zeros((height, width), bool)
    blocked[rows, columns] = True
    return blocked


def test_distances_are_exact():
    distance = obstacle_distance(wall())
    expected = ndi.distance_transform_edt(~wall())
    np.testing.assert_allclose(distance, expected, atol=1e-3)
    assert np.isinf(obstacle_distance(np.zeros((3, 3), bool))).all()


def test_costs_by_hand():
    distance = torch.tensor([[[0.0, 2.0, 2.1, 5.0, 5.1, torch.inf]]])
    cost = corridor_cost(distance, torch.tensor([2.0]), torch.tensor([5.0]), (1.0, 50.0, 200.0))
    assert cost.tolist() == [[[200.0, 200.0, 50.0, 50.0, 1.0, 1.0]]]


def plan(blocked, start, goal, inner=2.0, outer=5.0, points=64):
    distance = torch.from_numpy(obstacle_distance(blocked))[None]
    cost = corridor_cost(distance, torch.tensor([inner]), torch.tensor([outer]), (1.0, 50.0, 200.0))
    ends = torch.tensor([start], dtype=torch.float32), torch.tensor([goal], dtype=torch.float32)
    return least_cost_path(distance, cost, ends, points)[0].numpy()


def scene(distance, camera, object_position=(0.0, 0.0), tool_position=(0.0, 0.0), radius=0.0):
    return CorridorScene(
        camera=camera,
        obstacle_distance=distance,
        object_position=torch.as_tensor(object_position).reshape(-1, 2),
        object_radius=torch.full((len(distance),), radius),
        tool_position=torch.as_tensor(tool_position).reshape(-1, 2),
        tool_yaw=torch.zeros(len(distance)),
        goal=torch.zeros(len(distance), 2),
        touch_radius=torch.full((len(distance),), torch.inf),
    )


def test_the_path_keeps_out_of_the_zones_where_it_can():
    path = plan(wall(), (5, 5), (5, 35))
    distance = obstacle_distance(wall())
    along = [distance[round(v), round(u)] for u, v in path]
    assert min(along) > 4.0  # equally spaced points lie between cells: one cell's slack
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    assert steps.max() < 1.3 * steps.mean()
    assert path[0].tolist() == [5, 5]
    assert path[-1].tolist() == [5, 35]


def test_without_a_way_the_path_is_the_straight_line():
    path = plan(wall(columns=slice(0, 60)), (5, 5), (5, 35), points=7)
    np.testing.assert_allclose(path[:, 0], 5)
    np.testing.assert_allclose(path[:, 1], np.linspace(5, 35, 7), atol=1e-4)


def test_clearance_along_a_segment_by_hand():
    distance = obstacle_distance(wall())
    assert least_clearance(distance, 50.0, 5.0, 50.0, 35.0) == pytest.approx(11)  # column 39 to 50
    assert least_clearance(distance, 5.0, 5.0, 5.0, 35.0) == 0
    assert least_clearance(distance, 5.0, 5.0, 30.0, 5.0) == pytest.approx(13)
    assert least_clearance(distance, -90.0, -90.0, -80.0, -80.0) == np.inf


def test_away_from_obstacles_by_hand():
    distance = obstacle_distance(wall())
    assert away_from_obstacles(distance, 10.0, 14.0) == pytest.approx((0.0, -1.0, 4.0), abs=1e-3)
    assert away_from_obstacles(distance, 44.0, 20.0)[0] == pytest.approx(1.0, abs=1e-3)
    assert away_from_obstacles(np.full((5, 5), np.inf, np.float32), 2, 2) == (0.0, 0.0, np.inf)


def test_repulsion_turns_pixels_into_metres():
    camera = Camera(height=40, width=60)
    distance = obstacle_distance(wall())
    above = camera.unproject(torch.tensor([[10.0, 14.0]]))  # 4 cells above the wall
    push = tool_repulsion(scene([distance], camera, tool_position=above), 8 * camera.cell_size)
    torch.testing.assert_close(push, torch.tensor([[0.5, 0.0]]), atol=1e-3, rtol=0)  # up is +x
    right = camera.unproject(torch.tensor([[43.0, 20.0]]))  # 4 cells to the wall's right
    push = tool_repulsion(scene([distance], camera, tool_position=right), 8 * camera.cell_size)
    torch.testing.assert_close(push, torch.tensor([[0.0, -0.5]]), atol=0.02, rtol=0)  # right is -y
    none = tool_repulsion(scene([distance], camera, tool_position=above), 0.0)
    assert none.tolist() == [[0.0, 0.0]]


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


def test_the_furthest_point_that_is_seen_clear_of_the_outer_zone():
    path = plan(wall(), (5, 5), (5, 35))
    target = ahead(wall(), path, (5, 5))
    distance = obstacle_distance(wall())
    assert least_clearance(distance, 5.0, 5.0, *target) > 5
    index = np.abs(path - target).sum(1).argmin()
    for further in path[index + 2 :: 2]:
        assert least_clearance(distance, 5.0, 5.0, *further) <= 5
    assert index > 10


def test_failing_that_the_furthest_clear_of_the_inner_zone_that_the_tool_can_push_to():
    # The object stands 4 cells from the wall: nothing is clear of the outer zone (5) from there.
    path = np.linspace((10, 14), (58, 14), 49)
    assert ahead(wall(), path, (10, 14), tool=(2, 14)) == (58, 14)
    # The place behind the object lies at (6, 14); a tool across the wall does not see it, the path
    # is not clear of the outer zone there, so it falls back on the furthest clear of the inner one.
    assert ahead(wall(), path, (10, 14), tool=(6, 30)) == (58, 14)
    # 2 cells from the wall nothing is clear of the inner zone, but there is room for the object.
    path = np.linspace((10, 16), (58, 16), 49)
    assert ahead(wall(), path, (10, 16), tool=(2, 16)) == (58, 16)
    # And if the tool does not see the place behind: the previous target.
    assert ahead(wall(), path, (10, 16), tool=(6, 30)) == (9, 9)


def test_a_little_further_on_the_path_where_that_is_clear():
    # The object touches a wall at the image's rim, the tool stands outside; the path is clear.
    blocked = wall(rows=slice(0, 2))
    path = np.linspace((10, 10), (58, 10), 49)
    assert ahead(blocked, path, (12, 2), tool=(12, -5)) == (17, 10)
    assert ahead(blocked, path, (12, 2), tool=(12, -5), step=9) == (21, 10)


def test_relative_limits_let_an_object_at_a_wall_slide_along_it():
    path = np.linspace((10, 16), (58, 16), 49)
    faithful = ahead(wall(), path, (10, 17), tool=(6, 30))
    assert faithful == (9, 9)  # sees nothing, keeps the target before
    target = ahead(wall(), path, (10, 16), tool=(2, 16), relative=True)
    assert target == (58, 16)


def test_a_smaller_touch_radius_lets_the_object_see_through_a_narrower_gap():
    camera, config = Camera(), CorridorConfig(contact_distance=0.0)
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
        targets.append(choose_targets(here, state, config, RULES["faithful"]))
    torch.testing.assert_close(targets[0], previous)  # sees nothing, keeps the target before
    torch.testing.assert_close(targets[1], goal)


def test_relative_limits_ask_for_room_behind_the_object():
    # At the end of a dead-end street the goal is seen, but the place behind lies in the wall.
    blocked = wall(rows=slice(18, 22), columns=slice(0, 60))
    path = np.linspace((30, 15), (30, 2), 14)
    assert ahead(blocked, path, (30, 15), tool=(30, 17), relative=True, room=0.0) == (30, 10)
    path = np.linspace((30, 15), (50, 15), 21)
    assert ahead(blocked, path, (30, 15), tool=(20, 15), relative=True) == (50, 15)


def test_at_first_points_are_skipped_whose_place_behind_is_blocked():
    # Pushing straight up from (10, 14) needs the tool at (10, 18), in the wall.
    path = np.linspace((10, 14), (10, 2), 13)
    limits = (1.0, 0.5, 0.2)
    assert ahead(wall(), path, (10, 14), first=False, limits=limits) == (10, 2)
    assert ahead(wall(), path, (10, 14), first=True, limits=limits) == (10, 9)


def test_a_target_without_room_behind_is_turned_just_so_far_that_there_is():
    # 6 cells above the wall, to be pushed straight up: the tool would stand 5 further down, 1 off
    # the wall, and needs 3. At 45 degrees it stands 5 cos 45 = 3.5 down, 2.5 off; at 60 degrees
    # 2.5 down, 3.5 off.
    distance = obstacle_distance(wall())
    position, target = np.array([20.0, 12.0]), np.array([20.0, 2.0])
    u, v = turn_target(distance, position, target, RoomNeeded(5.0, 3.0, 4.0, 2.0))
    assert np.hypot(u - 20, v - 12) == pytest.approx(10)
    assert abs(np.degrees(np.arctan2(u - 20, 12 - v))) == pytest.approx(60)
    # Away from walls nothing is turned; nor where no turn makes room.
    assert turn_target(distance, position, target, RoomNeeded(3.0, 3.0, 4.0, 2.0)) == pytest.approx(
        (20, 2)
    )
    assert turn_target(
        distance, position, target, RoomNeeded(5.0, 30.0, 4.0, 2.0)
    ) == pytest.approx((20, 2))


def test_a_turned_target_does_not_lead_into_an_obstacle():
    distance = obstacle_distance(wall())
    # To be pushed down into the wall: turned until 4 cells ahead keep 2 cells off it.
    position, target = np.array([20.0, 14.0]), np.array([20.0, 24.0])
    _, v = turn_target(distance, position, target, RoomNeeded(5.0, 1.0, 4.0, 2.0))
    ahead = 14 + 0.4 * (v - 14)
    assert distance[round(ahead), 20] >= 2
    assert ahead > 14


def test_the_tool_s_path_leads_round_the_object():
    camera = Camera(height=40, width=60)
    size, none = camera.cell_size, np.full((40, 60), np.inf, np.float32)
    position = camera.unproject(torch.tensor([[30.0, 20.0]]))
    target = camera.unproject(torch.tensor([[50.0, 20.0]]))
    tool = camera.unproject(torch.tensor([[45.0, 20.0]]))  # on the wrong side
    config = CorridorConfig(near_distance=8 * size, tool_clearance=0.0)
    trail = []
    for _ in range(40):
        now = scene([none], camera, position, tool)
        ahead = next_tool_position(now, target, config, LazyThetaStar())
        step = ahead - tool
        tool = tool + step * (1.5 * size / step.norm().clamp_min(1.5 * size))
        trail.append(camera.project(tool)[0])
    away = (torch.stack(trail) - torch.tensor([30.0, 20.0])).norm(dim=-1)
    assert away.min() > 6.5
    assert trail[-1][0] < 30 - 6
    assert abs(trail[-1][1] - 20) < 3


def test_the_object_s_clearance_in_metres():
    camera = Camera(height=40, width=60)
    spots = camera.unproject(torch.tensor([[10.0, 14.0], [10.0, -30.0]]))
    clear = object_clearance(scene([obstacle_distance(wall())] * 2, camera, spots))
    assert clear.tolist() == pytest.approx([4 * camera.cell_size, 18 * camera.cell_size], rel=1e-3)


def test_distances_depend_on_the_images_alone():
    camera = Camera(height=40, width=60)
    remembering = ObstacleDistances(camera)
    depth = torch.full((2, 40, 60), camera.z)
    labels = torch.zeros(2, 40, 60, dtype=torch.uint8)
    for columns in (slice(0, 40), slice(0, 40), slice(20, 60)):
        depth[:] = camera.z
        depth[0, torch.from_numpy(wall(columns=columns))] = camera.z - 0.02
        got = remembering(depth, labels)
        for one, expected in zip(got, ObstacleDistances(camera)(depth, labels), strict=True):
            np.testing.assert_allclose(one, expected, rtol=1e-6)  # OpenCV rounds by alignment
        assert (got[0][20, 50] == 0) == (columns.stop > 50)  # the wall has moved, and so did they
        assert np.isinf(got[1]).all()
