"""Corridor geometry by hand: distances, costs, paths, look-ahead."""

import numpy as np
import pytest
import scipy.ndimage as ndi
import torch

from modpush.agents.corridor.corridor import (
    corridor_cost,
    corridor_path,
    least_clearance,
    look_ahead,
    obstacle_distance,
    outside,
)
from modpush.agents.corridor.tool_path import (
    away_from_obstacles,
    clearances_at,
    repulsion,
    turn_to_room,
    way_behind,
)
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
    return corridor_path(distance, cost, *ends, points)[0].numpy()


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
    push = repulsion([distance], above, 8 * camera.cell_size, camera)
    torch.testing.assert_close(push, torch.tensor([[0.5, 0.0]]), atol=1e-3, rtol=0)  # up is +x
    right = camera.unproject(torch.tensor([[43.0, 20.0]]))  # 4 cells to the wall's right
    push = repulsion([distance], right, 8 * camera.cell_size, camera)
    torch.testing.assert_close(push, torch.tensor([[0.0, -0.5]]), atol=0.02, rtol=0)  # right is -y
    assert repulsion([distance], above, 0.0, camera).tolist() == [[0.0, 0.0]]


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
    return look_ahead(
        obstacle_distance(blocked),
        np.asarray(path, float),
        np.asarray(position, float),
        np.asarray(tool, float),
        np.asarray(previous, float),
        first,
        behind,
        limits,
        relative,
        room,
        step,
    )


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
    u, v = turn_to_room(distance, position, target, 5.0, 3.0, 4.0, 2.0)
    assert np.hypot(u - 20, v - 12) == pytest.approx(10)
    assert abs(np.degrees(np.arctan2(u - 20, 12 - v))) == pytest.approx(60)
    # Away from walls nothing is turned; nor where no turn makes room.
    assert turn_to_room(distance, position, target, 3.0, 3.0, 4.0, 2.0) == pytest.approx((20, 2))
    assert turn_to_room(distance, position, target, 5.0, 30.0, 4.0, 2.0) == pytest.approx((20, 2))


def test_a_turned_target_does_not_lead_into_an_obstacle():
    distance = obstacle_distance(wall())
    # To be pushed down into the wall: turned until 4 cells ahead keep 2 cells off it.
    position, target = np.array([20.0, 14.0]), np.array([20.0, 24.0])
    _, v = turn_to_room(distance, position, target, 5.0, 1.0, 4.0, 2.0)
    ahead = 14 + 0.4 * (v - 14)
    assert distance[round(ahead), 20] >= 2
    assert ahead > 14


def test_the_tool_s_way_behind_leads_round_the_object():
    camera = Camera(height=40, width=60)
    size, none = camera.cell_size, np.full((40, 60), np.inf, np.float32)
    position = camera.unproject(torch.tensor([[30.0, 20.0]]))
    target = camera.unproject(torch.tensor([[50.0, 20.0]]))
    tool = camera.unproject(torch.tensor([[45.0, 20.0]]))  # on the wrong side
    keep_off = torch.tensor([8 * size])
    trail = []
    for _ in range(40):
        ahead = way_behind(LazyThetaStar(), [none], position, target, tool, keep_off, 0.0, camera)
        step = ahead - tool
        tool = tool + step * (1.5 * size / step.norm().clamp_min(1.5 * size))
        trail.append(camera.project(tool)[0])
    away = (torch.stack(trail) - torch.tensor([30.0, 20.0])).norm(dim=-1)
    assert away.min() > 6.5
    assert trail[-1][0] < 30 - 6
    assert abs(trail[-1][1] - 20) < 3


def test_clearances_in_metres():
    camera = Camera(height=40, width=60)
    spots = camera.unproject(torch.tensor([[10.0, 14.0], [10.0, -30.0]]))
    clear = clearances_at([obstacle_distance(wall())] * 2, spots, camera)
    assert clear.tolist() == pytest.approx([4 * camera.cell_size, 18 * camera.cell_size], rel=1e-3)


def test_cells_outside_of_a_rectangle():
    camera = Camera()
    beyond = outside(camera, (0.20, -0.35), (0.75, 0.35))
    inside = camera.project(torch.tensor([[0.21, -0.34], [0.74, 0.34], [0.5, 0.0]])).round().int()
    off = camera.project(torch.tensor([[0.19, 0.0], [0.76, 0.0], [0.5, 0.36], [0.5, -0.36]]))
    assert not any(beyond[v, u] for u, v in inside)
    assert all(beyond[v, u] for u, v in off.round().int())
