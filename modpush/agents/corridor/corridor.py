"""The pushing corridor: zones around obstacles, the path that keeps clear of them, the look-ahead.

Source: Krivic and Piater (2019) in the form of the code that the paper compares with: increased
costs around obstacles, and the relaxed look-ahead with its fallbacks.
"""

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from numba import njit
from numpy.typing import NDArray
from torch import Tensor

from modpush.geometry import Camera
from modpush.planners import AStar, point_along


@dataclass(frozen=True, kw_only=True)
class Clearances:
    """How far the object's centre keeps from obstacles, in three degrees [cells].

    Attributes:
        outer: Within it the tool behind the object may touch one.
        inner: Within it the object may touch one.
        touch: Within it the object does touch one.
    """

    outer: float
    inner: float
    touch: float


def obstacle_distance(blocked: NDArray) -> NDArray:
    """Exact distance of each cell's centre to the nearest blocked one's.

    Args:
        blocked: `[H, W]` bool.

    Returns:
        `[H, W]` float32 [cells], inf where nothing is blocked.
    """
    if not blocked.any():
        return np.full(blocked.shape, np.inf, dtype=np.float32)
    free = np.ascontiguousarray(~blocked, dtype=np.uint8)
    return cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)


def corridor_cost(
    distance: Tensor, inner: Tensor, outer: Tensor, weights: tuple[float, float, float]
) -> Tensor:
    """What a cell costs that lies so far from obstacles.

    Args:
        distance: `[B, H, W]` [cells].
        inner: `[B]` [cells].
        outer: `[B]` [cells].
        weights: Cost of a free cell, of one within `outer`, of one within `inner`.

    Returns:
        `[B, H, W]` float32.
    """
    inner, outer = inner[:, None, None], outer[:, None, None]
    cost = torch.full_like(distance, weights[0])
    cost[distance <= outer] = weights[1]
    cost[distance <= inner] = weights[2]
    return cost


def outside(camera: Camera, low: tuple[float, float], high: tuple[float, float]) -> Tensor:
    """Which cells lie outside of a rectangle on the table, `[H, W]` bool.

    Args:
        camera: The camera, whose pixels are the grid's cells.
        low: Lower corner (x, y) [m].
        high: Upper corner (x, y) [m].
    """
    grid = torch.meshgrid(torch.arange(camera.width), torch.arange(camera.height), indexing="xy")
    position = camera.unproject(torch.stack(grid, -1).float())
    return ((position < torch.tensor(low)) | (position > torch.tensor(high))).any(-1)


def corridor_path(
    distance: Tensor, cost: Tensor, start: Tensor, goal: Tensor, points: int, neighbours: int = 8
) -> Tensor:
    """The way of least cost from the object to the goal, as points equally far apart.

    Args:
        distance: `[B, H, W]` [cells], 0 on obstacles.
        cost: `[B, H, W]` float32.
        start: `[B, 2]` (u, v) [px].
        goal: `[B, 2]` (u, v) [px].
        points: How many.
        neighbours: 4 or 8.

    Returns:
        `[B, points, 2]` (u, v) [px]; the straight line where there is no way.
    """
    planner = AStar(neighbours=8 if neighbours == 8 else 4)
    paths = planner.plan_weighted(distance == 0, cost, start, goal)
    straight = torch.stack([start, goal], 1)
    straight = torch.cat([straight, goal[:, None].expand(-1, paths.waypoints.shape[1] - 2, 2)], 1)
    line = torch.where(paths.found[:, None, None], paths.waypoints, straight)
    length = (line[:, 1:] - line[:, :-1]).norm(dim=-1).sum(-1)
    ways = length[:, None] * torch.linspace(0.0, 1.0, points)  # [B, points]
    lines = line.repeat_interleave(points, 0)  # all points of all scenes at once
    return point_along(lines, ways.flatten()).reshape(len(line), points, 2)


@njit(cache=True, nogil=True)
def least_clearance(distance: NDArray, u0: float, v0: float, u1: float, v1: float) -> float:
    """Least distance to obstacles on a segment [px], seen every half cell; inf off the grid."""
    steps = int(np.ceil(2.0 * max(abs(u1 - u0), abs(v1 - v0)))) + 1
    least = np.inf
    for k in range(steps + 1):
        i = int(np.rint(u0 + (u1 - u0) * k / steps))
        j = int(np.rint(v0 + (v1 - v0) * k / steps))
        if 0 <= i < distance.shape[1] and 0 <= j < distance.shape[0]:
            least = min(least, distance[j, i])
    return least


@njit(cache=True, nogil=True)
def _behind(position: NDArray, point: NDArray, distance: float) -> tuple[float, float]:
    """The place to push the object from towards a point."""
    du, dv = position[0] - point[0], position[1] - point[1]
    length = max(np.sqrt(du * du + dv * dv), 1e-9)
    return position[0] + du / length * distance, position[1] + dv / length * distance


@njit(cache=True, nogil=True)
def _has_room_behind(
    distance: NDArray, position: NDArray, point: NDArray, behind: float, room: float
) -> bool:
    """Whether obstacles are further than `room` from the place to push from towards a point."""
    u, v = _behind(position, point, behind)
    return least_clearance(distance, u, v, u, v) > room


@njit(cache=True, nogil=True)
def _tool_sees_behind(
    distance: NDArray, position: NDArray, point: NDArray, behind: float, tool: NDArray, room: float
) -> bool:
    """Whether the tool's straight way to that place keeps further than `room` from obstacles."""
    u, v = _behind(position, point, behind)
    return least_clearance(distance, u, v, tool[0], tool[1]) > room


@njit(cache=True, nogil=True)
def _nearest_point(path: NDArray, position: NDArray) -> int:
    """The index of the path's point nearest to a position."""
    nearest, least = 0, np.inf
    for k in range(path.shape[0]):
        away = (path[k, 0] - position[0]) ** 2 + (path[k, 1] - position[1]) ** 2
        if away < least:
            nearest, least = k, away
    return nearest


@njit(cache=True, nogil=True)
def _furthest_clear(
    distance: NDArray,
    path: NDArray,
    position: NDArray,
    nearest: int,
    first: bool,
    behind: float,
    limits: tuple[float, float, float],
    near_obstacle: bool,
    room: float,
) -> tuple[int, int, int]:
    """The furthest points that the object sees past the outer zone, the inner zone, obstacles.

    Every second point of the path counts, from the goal back to the nearest one; -1 for none.
    """
    outer, inner, touch = limits
    last = path.shape[0] - 1
    free, tight, supertight = -1, -1, -1
    for k in range(last, nearest - 1, -2):
        point = path[k]
        if (point[0] - position[0]) ** 2 + (point[1] - position[1]) ** 2 < 1.0 and k < last:
            continue  # no direction to push in
        if first and not _has_room_behind(distance, position, point, behind, 0.0):
            continue
        clear = least_clearance(distance, position[0], position[1], point[0], point[1])
        if clear <= touch:
            continue
        # Near an obstacle a clear way does not mean that there is room behind the object too.
        if near_obstacle and not _has_room_behind(distance, position, point, behind, room):
            continue
        if supertight < 0:
            supertight = k
        if clear > inner and tight < 0:
            tight = k
        if clear > outer:
            free = k
            break  # a way clear of the outer zone is clear of the others: both are set by now
    return free, tight, supertight


@njit(cache=True, nogil=True)
def _fallback(
    distance: NDArray,
    path: NDArray,
    position: NDArray,
    tool: NDArray,
    nearest: int,
    seen: tuple[int, int, int],
    behind: float,
    outer: float,
    always: bool,
    room: float,
    step: int,
) -> int:
    """The path's point to push towards where none is seen past the outer zone; -1 for none.

    `seen` is from `_furthest_clear`; with `always` there is one.
    """
    _, tight, supertight = seen
    for k in seen:
        if k >= 0 and _tool_sees_behind(distance, position, path[k], behind, tool, room):
            return k
    ahead = min(nearest + step, path.shape[0] - 1)
    u, v = path[nearest, 0], path[nearest, 1]
    if least_clearance(distance, u, v, u, v) > outer and _tool_sees_behind(
        distance, position, path[nearest], behind, tool, room
    ):
        return ahead
    if tight >= 0:
        return tight
    if always:
        return supertight if supertight >= 0 else ahead
    return -1


@njit(cache=True, nogil=True)
def look_ahead(
    distance: NDArray,
    path: NDArray,
    position: NDArray,
    tool: NDArray,
    previous: NDArray,
    first: bool,
    behind: float,
    limits: tuple[float, float, float],
    relative: bool,
    room: float,
    step: int,
) -> tuple[float, float]:
    """The point on the path to push towards now.

    The furthest one to which the object's way is clear of the outer zone. Failing that, in this
    order: the furthest clear of the inner zone, if the tool can see the place behind the object;
    the furthest that leaves the object room, if so; a point a little further on the path, if the
    path is clear there; the furthest clear of the inner zone; the previous target.

    Args:
        distance: `[H, W]` float32, to obstacles [cells].
        path: `[N, 2]` (u, v) [px], goal last.
        position: `[2]` the object's.
        tool: `[2]` the tool's.
        previous: `[2]` the target before.
        first: There is none before.
        behind: How far behind the object the tool stands to push it [px].
        limits: Outer zone, inner zone, room that the object needs [cells].
        relative: An object that is nearer to an obstacle than a limit asks only not to get nearer
            still, and for room behind it. Else it sees no way at all until it is out.
        room: What the tool needs to either side [cells].
        step: How many points a little further on the path is.

    Returns:
        (u, v) [px].
    """
    outer, inner, touch = limits
    near_obstacle = False
    if relative:
        here = least_clearance(distance, position[0], position[1], position[0], position[1]) - 1.0
        near_obstacle = here < outer
        outer, inner, touch = min(outer, here), min(inner, here), min(touch, here)
    nearest = _nearest_point(path, position)
    zones = (outer, inner, touch)
    seen = _furthest_clear(
        distance, path, position, nearest, first, behind, zones, near_obstacle, room
    )
    k = seen[0]
    if k < 0 or near_obstacle:
        k = _fallback(
            distance, path, position, tool, nearest, seen, behind, outer, relative, room, step
        )
    if k < 0 and first:
        k = min(nearest + step, path.shape[0] - 1)
    if k < 0:
        return previous[0], previous[1]
    return path[k, 0], path[k, 1]


def to_targets(
    distance: list[NDArray],
    path: Tensor,
    position: Tensor,
    tool: Tensor,
    previous: Tensor,
    first: Tensor,
    behind: float,
    clearances: list[Clearances],
    relative: bool,
    room: float,
    step: int,
    camera: Camera,
) -> Tensor:
    """`look_ahead` for a batch, in metres.

    Args:
        distance: For each scene `[H, W]` float32 [cells].
        path: `[B, N, 2]` (x, y) [m].
        position: `[B, 2]` the object's [m].
        tool: `[B, 2]` the tool's [m].
        previous: `[B, 2]` the targets before [m].
        first: `[B]` bool, there is none before.
        behind: How far behind the object the tool stands to push it [m].
        clearances: For each scene.
        relative: See `look_ahead`.
        room: What the tool needs to either side [m].
        step: See `look_ahead`.
        camera: The camera, whose pixels are the grid's cells.

    Returns:
        `[B, 2]` (x, y) [m].
    """
    pixels = [camera.project(value.double()).numpy() for value in (path, position, tool, previous)]
    targets = [
        look_ahead(
            distance[b],
            *(value[b] for value in pixels),
            bool(first[b]),
            behind / camera.cell_size,
            (clearances[b].outer, clearances[b].inner, clearances[b].touch),
            relative,
            room / camera.cell_size,
            step,
        )
        for b in range(len(distance))
    ]
    return camera.unproject(torch.tensor(targets, dtype=torch.float64)).to(position.dtype)
