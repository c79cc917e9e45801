"""Distances between points and the footprints of obstacles, compiled."""

import math
from collections.abc import Sequence

import numpy as np

from modpush._kernels import njit
from modpush.envs.scenes.obstacle import Obstacle

GRID_LOW, GRID_SIDE = (0.145, -0.455), 0.91
"""Lower corner of a grid of places of the object, and length of its sides [m]."""


def obstacle_distance(points: np.ndarray, obstacles: Sequence[Obstacle]) -> np.ndarray:
    """Distance `[...]` from points `[..., 2]` to the nearest obstacle seen from above [m].

    It is 0 inside an obstacle, and infinite if there is none.
    """
    rows = rectangles(obstacles)
    flat = np.ascontiguousarray(points, dtype=np.float64).reshape(-1, 2)
    return _rectangle_distance(flat, rows).reshape(points.shape[:-1])


def rectangles(obstacles: Sequence[Obstacle]) -> np.ndarray:
    """Footprints (x, y, yaw, length, width), `[n, 5]` [m, m, rad, m, m]."""
    return np.array([(*o.pose, *o.size[:2]) for o in obstacles], dtype=np.float64).reshape(-1, 5)


@njit()
def _rectangle_distance(points: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Per point the distance to the nearest of the rectangles (x, y, yaw, length, width)."""
    turned, nearest = turned_rectangles(rows), np.empty(len(points))
    for i in range(len(points)):
        nearest[i] = nearest_rectangle(points[i, 0], points[i, 1], turned)
    return nearest


@njit()
def turned_rectangles(rows: np.ndarray) -> np.ndarray:
    """Rectangles (x, y, yaw, length, width) as `nearest_rectangle` reads them, `[n, 6]`."""
    turned = np.empty((len(rows), 6))
    for k in range(len(rows)):
        x, y, yaw, length, width = rows[k]
        turned[k, 0], turned[k, 1] = x, y
        turned[k, 2], turned[k, 3] = math.cos(yaw), math.sin(yaw)
        turned[k, 4], turned[k, 5] = length / 2, width / 2
    return turned


@njit()
def nearest_rectangle(x: float, y: float, turned: np.ndarray) -> float:
    """Distance from one point to the nearest rectangle [m]: 0 inside one, inf for none."""
    least = np.inf
    for k in range(len(turned)):
        dx, dy = x - turned[k, 0], y - turned[k, 1]
        c, s = turned[k, 2], turned[k, 3]
        u = max(abs(dx * c + dy * s) - turned[k, 4], 0.0)
        v = max(abs(dy * c - dx * s) - turned[k, 5], 0.0)
        least = min(least, u * u + v * v)
    return math.sqrt(least)


@njit()
def crosses_rectangle(start: np.ndarray, end: np.ndarray, turned: np.ndarray) -> bool:
    """True if the straight way between two points `[2]` leads through a rectangle."""
    for k in range(len(turned)):
        x, y, c, s, half_length, half_width = turned[k]
        enter, leave = 0.0, 1.0  # as fractions of the way
        for axis_x, axis_y, half in ((c, s, half_length), (-s, c, half_width)):
            first = (start[0] - x) * axis_x + (start[1] - y) * axis_y
            way = (end[0] - start[0]) * axis_x + (end[1] - start[1]) * axis_y
            if way == 0.0:
                if abs(first) > half:
                    leave = -1.0
            else:
                one, other = (-half - first) / way, (half - first) / way
                enter, leave = max(enter, min(one, other)), min(leave, max(one, other))
        if enter <= leave:
            return True
    return False


@njit()
def rectangles_touch(row: np.ndarray, rows: np.ndarray, gap: float) -> bool:
    """True if a rectangle (x, y, yaw, length, width) overlaps one of several, enlarged by a gap [m].

    Two rectangles are apart if their shadows are on a line along a side of either.
    """
    turned = turned_rectangles(np.concatenate((row.reshape(1, 5), rows)))
    x, y, c, s, half_length, half_width = turned[0]
    for k in range(1, len(turned)):
        dx, dy = turned[k, 0] - x, turned[k, 1] - y
        other_c, other_s, other_length, other_width = turned[k, 2:]
        cos, sin = abs(c * other_c + s * other_s), abs(c * other_s - s * other_c)
        apart = (
            abs(dx * c + dy * s) > half_length + other_length * cos + other_width * sin + gap
            or abs(dy * c - dx * s) > half_width + other_length * sin + other_width * cos + gap
            or abs(dx * other_c + dy * other_s)
            > other_length + half_length * cos + half_width * sin + gap
            or abs(dy * other_c - dx * other_s)
            > other_width + half_length * sin + half_width * cos + gap
        )
        if not apart:
            return True
    return False


@njit()
def passable_cells(
    turned: np.ndarray, radius: float, low: np.ndarray, high: np.ndarray, cell: float
) -> np.ndarray:
    """The cells within a rectangle whose centre is further than a radius from the obstacles, `[n, n]`.

    Only the cells in an obstacle's bounding box, made larger by the radius, are compared with it.
    """
    side = round(GRID_SIDE / cell)
    passable = np.zeros((side, side), np.uint8)
    for i in range(side):
        x = GRID_LOW[0] + (i + 0.5) * cell
        if low[0] <= x <= high[0]:
            for j in range(side):
                y = GRID_LOW[1] + (j + 0.5) * cell
                passable[i, j] = low[1] <= y <= high[1]
    for k in range(len(turned)):
        c, s, half_length, half_width = np.abs(turned[k, 2:])
        reach_x = c * half_length + s * half_width + radius
        reach_y = s * half_length + c * half_width + radius
        first_i = max(0, int((turned[k, 0] - reach_x - GRID_LOW[0]) / cell - 1.0))
        first_j = max(0, int((turned[k, 1] - reach_y - GRID_LOW[1]) / cell - 1.0))
        last_i = min(side - 1, int((turned[k, 0] + reach_x - GRID_LOW[0]) / cell + 1.0))
        last_j = min(side - 1, int((turned[k, 1] + reach_y - GRID_LOW[1]) / cell + 1.0))
        for i in range(first_i, last_i + 1):
            x = GRID_LOW[0] + (i + 0.5) * cell
            for j in range(first_j, last_j + 1):
                y = GRID_LOW[1] + (j + 0.5) * cell
                if passable[i, j] and nearest_rectangle(x, y, turned[k : k + 1]) <= radius:
                    passable[i, j] = 0
    return passable
