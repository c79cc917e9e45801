"""The pushing corridor: zones around obstacles, the path that keeps clear of them, the look-ahead.

Source: Krivic and Piater (2019) in the form of the code that the paper compares with: increased
costs around obstacles, and the relaxed look-ahead with its fallbacks.
"""

import cv2
import numpy as np
import torch
from numba import njit
from numpy.typing import NDArray
from torch import Tensor

from modpush.planners import AStar, GridFrame, point_along

# Zones of the table by their distance to obstacles.
FREE, OUTER, INNER, OBSTACLE = 0, 1, 2, 3


def corridor_zones(blocked: NDArray, inner: float, outer: float) -> NDArray:
    """How near to an obstacle each cell lies.

    Args:
        blocked: `[H, W]` bool, where obstacles stand.
        inner: Cells within so many cells of one are `INNER`: the object would touch it.
        outer: Cells within so many are `OUTER`: the tool would, behind the object.

    Returns:
        `[H, W]` uint8.
    """
    if not blocked.any():
        return np.zeros(blocked.shape, dtype=np.uint8)
    free = np.ascontiguousarray(~blocked, dtype=np.uint8)
    distance = cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    zones = np.full(blocked.shape, FREE, dtype=np.uint8)
    zones[distance <= outer] = OUTER
    zones[distance <= inner] = INNER
    zones[blocked] = OBSTACLE
    return zones


def corridor_path(
    zones: Tensor,
    start: Tensor,
    goal: Tensor,
    points: int,
    weights: tuple[float, float, float],
    neighbours: int = 8,
) -> Tensor:
    """The way of least cost from the object to the goal, as points equally far apart.

    Args:
        zones: `[B, H, W]` uint8.
        start: `[B, 2]` (u, v) [px].
        goal: `[B, 2]` (u, v) [px].
        points: How many.
        weights: Cost of a cell that is free, outer, inner.
        neighbours: 4 or 8.

    Returns:
        `[B, points, 2]` (u, v) [px]; the straight line where there is no way.
    """
    cost = torch.tensor([*weights, 1.0])[zones.long()]
    planner = AStar(neighbours=8 if neighbours == 8 else 4)
    paths = planner.plan_weighted(zones == OBSTACLE, cost, start, goal)
    straight = torch.stack([start, goal], 1)
    straight = torch.cat([straight, goal[:, None].expand(-1, paths.waypoints.shape[1] - 2, 2)], 1)
    line = torch.where(paths.found[:, None, None], paths.waypoints, straight)
    length = (line[:, 1:] - line[:, :-1]).norm(dim=-1).sum(-1)
    parts = [point_along(line, length * k / (points - 1)) for k in range(points)]
    return torch.stack(parts, 1)


@njit(cache=True, nogil=True)
def worst_zone(zones: NDArray, u0: float, v0: float, u1: float, v1: float) -> int:
    """The worst zone on the segment between two points [px], looked at every half cell.

    Points outside the grid count as free: the tool may go there.
    """
    steps = int(np.ceil(2.0 * max(abs(u1 - u0), abs(v1 - v0)))) + 1
    worst = FREE
    for k in range(steps + 1):
        i = int(np.rint(u0 + (u1 - u0) * k / steps))
        j = int(np.rint(v0 + (v1 - v0) * k / steps))
        if 0 <= i < zones.shape[1] and 0 <= j < zones.shape[0]:
            worst = max(worst, int(zones[j, i]))
    return worst


@njit(cache=True, nogil=True)
def _behind(position: NDArray, point: NDArray, distance: float) -> tuple[float, float]:
    """The place to push the object from towards a point."""
    du, dv = position[0] - point[0], position[1] - point[1]
    length = max(np.sqrt(du * du + dv * dv), 1e-9)
    return position[0] + du / length * distance, position[1] + dv / length * distance


@njit(cache=True, nogil=True)
def look_ahead(
    zones: NDArray,
    path: NDArray,
    position: NDArray,
    tool: NDArray,
    previous: NDArray,
    first: bool,
    behind: float,
) -> tuple[float, float]:
    """The point on the path to push towards now.

    The furthest one that is seen through free cells only. Failing that, in this order: the furthest
    seen without an inner cell, if the place behind the object is within the tool's sight; the
    furthest seen at all, if so; a point a little further on the path, if the object's part of it is
    free; the furthest seen without an inner cell; the previous target.

    Args:
        zones: `[H, W]` uint8.
        path: `[N, 2]` (u, v) [px], goal last.
        position: `[2]` the object's.
        tool: `[2]` the tool's.
        previous: `[2]` the target before.
        first: There is none before.
        behind: How far behind the object the tool stands to push it [px].

    Returns:
        (u, v) [px].
    """
    count = path.shape[0]
    if not zones.any():
        return path[count - 1, 0], path[count - 1, 1]
    nearest, least = 0, np.inf
    for k in range(count):
        away = (path[k, 0] - position[0]) ** 2 + (path[k, 1] - position[1]) ** 2
        if away < least:
            nearest, least = k, away
    tight, supertight = -1, -1
    for k in range(count - 1, nearest - 1, -2):
        if first:
            bu, bv = _behind(position, path[k], behind)
            if worst_zone(zones, bu, bv, bu, bv) == OBSTACLE:
                continue
        worst = worst_zone(zones, position[0], position[1], path[k, 0], path[k, 1])
        if worst == FREE:
            return path[k, 0], path[k, 1]
        if worst <= OUTER and tight < 0:
            tight = k
        if worst <= INNER and supertight < 0:
            supertight = k
    for k in (tight, supertight):
        if k >= 0:
            bu, bv = _behind(position, path[k], behind)
            if worst_zone(zones, bu, bv, tool[0], tool[1]) < OBSTACLE:
                return path[k, 0], path[k, 1]
    ahead = min(nearest + 5, count - 1)
    if worst_zone(zones, path[nearest, 0], path[nearest, 1], path[nearest, 0], path[nearest, 1]) == 0:
        bu, bv = _behind(position, path[nearest], behind)
        if worst_zone(zones, bu, bv, tool[0], tool[1]) < OBSTACLE:
            return path[ahead, 0], path[ahead, 1]
    if tight >= 0:
        return path[tight, 0], path[tight, 1]
    if first:
        return path[ahead, 0], path[ahead, 1]
    return previous[0], previous[1]


def to_targets(
    zones: list[NDArray],
    path: Tensor,
    position: Tensor,
    tool: Tensor,
    previous: Tensor,
    first: Tensor,
    behind: Tensor,
    frame: GridFrame,
) -> Tensor:
    """`look_ahead` for a batch, in metres.

    Args:
        zones: For each scene `[H, W]` uint8.
        path: `[B, N, 2]` (x, y) [m].
        position: `[B, 2]` the object's [m].
        tool: `[B, 2]` the tool's [m].
        previous: `[B, 2]` the targets before [m].
        first: `[B]` bool, there is none before.
        behind: `[B]` [m].
        frame: The zones' frame.

    Returns:
        `[B, 2]` (x, y) [m].
    """
    pixels = [
        frame.to_pixel(value.double()).numpy() for value in (path, position, tool, previous)
    ]
    targets = [
        look_ahead(
            zones[b],
            *(value[b] for value in pixels),
            bool(first[b]),
            float(behind[b]) / frame.cell_size,
        )
        for b in range(len(zones))
    ]
    return frame.to_metre(torch.tensor(targets, dtype=torch.float64)).to(position.dtype)
