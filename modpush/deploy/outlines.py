"""Convex outlines in the plane, polygons with counter-clockwise corners: their distances, compiled."""

import math
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from modpush._kernels import njit
from modpush.envs.scenes.objects import PushedObject

_LEVEL = 2e-4
"""Corners within this distance of the foremost one are in contact with it [m]."""

Floats = NDArray[np.float64]


def padded(rows: Sequence[Floats]) -> tuple[Floats, NDArray[np.int64]]:
    """Arrays `[n, k]` in one array `[len(rows), n, k]`, and the length of each."""
    counts = np.array([len(row) for row in rows], dtype=np.int64)
    width = rows[0].shape[1] if rows else 2
    together = np.zeros((len(rows), counts.max(initial=1), width))
    for place_of, row in zip(together, rows, strict=True):
        place_of[: len(row)] = row
    return together, counts


def points_within(item: PushedObject, count: int) -> Floats:
    """Points of a grid of `count` by `count` that lie in an object's footprint, `[n, 2]` [m]."""
    side = np.linspace(-item.radius, item.radius, count)
    points = np.stack(np.meshgrid(side, side), -1).reshape(-1, 2)
    contours = [outline.astype(np.float32) for outline in item.footprints()]
    inside = [
        any(cv2.pointPolygonTest(contour, (float(x), float(y)), False) >= 0 for contour in contours)
        for x, y in points
    ]
    return points[inside]


@njit(error_model="numpy")
def place(outline: Floats, x: float, y: float, yaw: float, out: Floats) -> None:
    """Corners `[n, 2]` of an outline at a pose."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    for i in range(len(outline)):
        a, b = outline[i]
        out[i, 0], out[i, 1] = x + cos * a - sin * b, y + sin * a + cos * b


@njit(error_model="numpy")
def overlap(first: Floats, second: Floats) -> tuple[float, float, float, float, float]:
    """Depth of the overlap of two outlines, corners `[n, 2]` each, and where they would touch [m].

    Returns:
        The least distance by which `second` must move to be free, negative where they are apart; the
        direction (x, y) in which it must; and the middle (x, y) of their contact.
    """
    depth, nx, ny = _least_overlap(first, second, 1.0, np.inf, 0.0, 0.0)
    depth, nx, ny = _least_overlap(second, first, -1.0, depth, nx, ny)
    # Both sides of the contact along its tangent; where they overlap they touch.
    low, high = _touching(first, nx, ny, 1.0)
    other_low, other_high = _touching(second, nx, ny, -1.0)
    along = 0.5 * (max(low, other_low) + min(high, other_high))
    foremost = -np.inf
    for i in range(len(first)):
        foremost = max(foremost, first[i, 0] * nx + first[i, 1] * ny)
    across = foremost - 0.5 * depth
    return depth, nx, ny, across * nx - along * ny, across * ny + along * nx


@njit(error_model="numpy")
def _least_overlap(
    one: Floats, other: Floats, sign: float, depth: float, nx: float, ny: float
) -> tuple[float, float, float]:
    """Least overlap along the normals of `one`, if it is less than `depth`."""
    n = len(one)
    for i in range(n):
        k = i + 1 if i + 1 < n else 0
        sx, sy = one[k, 0] - one[i, 0], one[k, 1] - one[i, 1]
        length = math.sqrt(sx * sx + sy * sy)
        ax, ay = sy / length, -sx / length
        face, least = one[i, 0] * ax + one[i, 1] * ay, np.inf
        for m in range(len(other)):
            least = min(least, other[m, 0] * ax + other[m, 1] * ay)
        if face - least < depth:
            depth, nx, ny = face - least, sign * ax, sign * ay
    return depth, nx, ny


@njit(error_model="numpy")
def _touching(outline: Floats, nx: float, ny: float, sign: float) -> tuple[float, float]:
    """Interval along the tangent (-ny, nx) of the corners that are foremost along +-n."""
    foremost = -np.inf
    for i in range(len(outline)):
        foremost = max(foremost, sign * (outline[i, 0] * nx + outline[i, 1] * ny))
    low, high = np.inf, -np.inf
    for i in range(len(outline)):
        if sign * (outline[i, 0] * nx + outline[i, 1] * ny) > foremost - _LEVEL:
            along = -outline[i, 0] * ny + outline[i, 1] * nx
            low, high = min(low, along), max(high, along)
    return low, high
