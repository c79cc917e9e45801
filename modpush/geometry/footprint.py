"""Footprints of upright primitives: outline, size, centroid and symmetry of a body from above."""

import functools
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from modpush.geometry.shapes import Primitive

_MAX_ORDER = 24  # largest order of a symmetry that is tested
_TOLERANCE = 1e-6  # largest distance of equal outlines [m]


def outline_of(part: Primitive, num_arc: int = 32) -> NDArray[np.float64]:
    """Outline of an upright primitive seen from above, counter-clockwise, `[n, 2]` [m].

    It is in the body's frame; a circle gets `num_arc` corners.
    """
    if part.kind == "prism":
        corners = np.array(part.outline)
    elif part.kind == "box":
        hx, hy = part.size[:2]
        corners = np.array([[hx, hy], [-hx, hy], [-hx, -hy], [hx, -hy]])
    else:
        angle = np.linspace(0.0, 2 * np.pi, num_arc, endpoint=False)
        corners = part.size[0] * np.stack([np.cos(angle), np.sin(angle)], -1)
    if part.rpy[2] != 0.0:
        corners = corners @ part.rotation()[:2, :2].T
    return corners + np.array(part.position[:2])


def support(parts: Sequence[Primitive], count: int) -> NDArray[np.float64]:
    """Support function of upright parts seen from above: their extent in each direction, `[count]` [m].

    It is measured from the body's origin; the first direction is along its x, the others follow
    counter-clockwise at equal angles.
    """
    angle = np.linspace(0.0, 2 * np.pi, count, endpoint=False)
    directions = np.stack([np.cos(angle), np.sin(angle)], -1)
    corners = np.concatenate([outline_of(part, 256) for part in parts])
    return (corners @ directions.T).max(0)


def vertical_range(part: Primitive) -> tuple[float, float]:
    """Lower and upper end of an upright primitive in the body's frame [m]."""
    half = part.size[2] if part.kind in ("box", "prism") else part.size[1]
    if part.kind == "capsule":
        half += part.size[0]
    return part.position[2] - half, part.position[2] + half


def circumscribed_radius(parts: Sequence[Primitive]) -> float:
    """Radius of the circle about the body's origin that holds all upright parts, seen from above [m]."""
    return max(_radius(part) for part in parts)


def _radius(part: Primitive) -> float:
    # Three formulas, since they differ in the last bit and shipped agents depend on these values.
    if part.kind == "prism":
        return float(np.linalg.norm(outline_of(part), axis=1).max())
    if part.kind == "box":
        return max(math.hypot(x, y) for x, y in outline_of(part).tolist())
    return math.hypot(*part.position[:2]) + part.size[0]


def centroid(parts: Sequence[Primitive]) -> tuple[float, float]:
    """Mean of the upright parts' centroids, weighted by their volumes, (x, y) [m].

    Where parts overlap, the overlap counts for each of them, as it does in PhysX.
    """
    areas, centers = zip(*(area_and_centroid(outline_of(part, 256)) for part in parts), strict=True)
    heights = np.array([np.ptp(vertical_range(part)) for part in parts])
    x, y = np.average(centers, axis=0, weights=np.array(areas) * heights).tolist()
    return x, y


def area_and_centroid(outline: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
    """Area [m^2] and centroid `[2]` [m] of a counter-clockwise outline `[n, 2]`."""
    following = np.roll(outline, -1, axis=0)
    cross = outline[:, 0] * following[:, 1] - following[:, 0] * outline[:, 1]
    area = cross.sum() / 2
    return float(area), ((outline + following) * cross[:, None]).sum(0) / (6 * area)


def centered(*parts: Primitive) -> tuple[Primitive, ...]:
    """Shift upright parts together to the origin of a `PushedObject`.

    Their centroid and the middle of their height are at the origin afterwards.

    Raises:
        TypeError: If there are none, or one is not a `Primitive`.
    """
    if not parts or not all(isinstance(part, Primitive) for part in parts):
        raise TypeError(f"centered: parts must be one Primitive or more, got {parts}.")
    x, y = centroid(parts)
    low, high = zip(*(vertical_range(part) for part in parts), strict=True)
    z = (min(low) + max(high)) / 2
    return tuple(
        replace(part, position=(part.position[0] - x, part.position[1] - y, part.position[2] - z))
        for part in parts
    )


@functools.cache
def yaw_symmetry(parts: tuple[Primitive, ...]) -> int:
    """Order of a body's rotational symmetry about z: 4 for a cube, 0 for a disc (any angle)."""
    round_parts = all(part.kind in ("cylinder", "capsule") for part in parts)
    if round_parts and all(math.hypot(*part.position[:2]) <= _TOLERANCE for part in parts):
        return 0
    orders = range(_MAX_ORDER, 1, -1)
    return next((n for n in orders if _looks_the_same(parts, 2 * math.pi / n)), 1)


def _looks_the_same(parts: Sequence[Primitive], yaw: float) -> bool:
    """True if the rotated parts lie within the parts at every height."""
    ranges = [vertical_range(part) for part in parts]
    levels = np.unique([end for ends in ranges for end in ends])
    turn = np.array([[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]])
    for z in (levels[1:] + levels[:-1]) / 2:
        here = [part for part, (low, high) in zip(parts, ranges, strict=True) if low < z < high]
        if here:
            points = np.vstack([_points_along(outline_of(part)) for part in here]) @ turn
            if not np.any([_within(part, points) for part in here], axis=0).all():
                return False
    return True


def _points_along(outline: NDArray[np.float64], count: int = 16) -> NDArray[np.float64]:
    """Points on the sides of an outline, `[n * count, 2]`."""
    share = np.arange(count)[:, None, None] / count
    return (outline + share * (np.roll(outline, -1, axis=0) - outline)).reshape(-1, 2)


def _within(part: Primitive, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Mask of the points in an upright part seen from above, within the tolerance, `[n]`."""
    if part.kind in ("cylinder", "capsule"):
        away = np.linalg.norm(points - np.array(part.position[:2]), axis=1)
        return away <= part.size[0] + _TOLERANCE
    return np.all(clearances(points, outline_of(part)) <= _TOLERANCE, axis=1)


def side_planes(outline: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Outward normals `[n, 2]` of a convex outline's sides, and distances from the origin `[n]` [m]."""
    side = np.roll(outline, -1, axis=0) - outline
    normal = np.stack([side[:, 1], -side[:, 0]], -1) / np.linalg.norm(side, axis=1)[:, None]
    return normal, (normal * outline).sum(1)


def clearances(points: NDArray[np.float64], outline: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distances of points `[n, 2]` to a convex outline's sides, `[n, sides]` [m]; positive outside."""
    normal, distance = side_planes(outline)
    return points @ normal.T - distance


_ARC = 256  # corners of a circle's outline
_OUTWARD = 1e-6  # offset outside a side at which its cover by other parts is tested [m]


def inscribed_radius(parts: Sequence[Primitive]) -> float:
    """Radius of the largest circle about the body's origin that lies within its footprint [m].

    The footprint is the union of the upright, convex parts seen from above. The radius is 0 where the
    origin lies outside it, and else the distance to the nearest piece of a part's outline that no
    other part covers.
    """
    if len(parts) == 1 and parts[0].kind in ("cylinder", "capsule"):
        return max(0.0, parts[0].size[0] - math.hypot(*parts[0].position[:2]))
    outlines = [outline_of(part, _ARC) for part in parts]
    if not any((clearances(np.zeros((1, 2)), outline) <= 0).all() for outline in outlines):
        return 0.0
    nearest = math.inf
    for index, outline in enumerate(outlines):
        others = outlines[:index] + outlines[index + 1 :]
        for start, end in zip(outline, np.roll(outline, -1, axis=0), strict=True):
            nearest = min(nearest, _distance_to_uncovered(start, end, others))
    return nearest


def _distance_to_uncovered(
    start: NDArray[np.float64], end: NDArray[np.float64], others: Sequence[NDArray[np.float64]]
) -> float:
    """Distance of the origin to the part of a side outside all other outlines, inf if there is none."""
    along = end - start
    length = float(np.linalg.norm(along))
    outward = np.array([along[1], -along[0]]) / length * _OUTWARD
    covered = [_covered_share(start + outward, end + outward, other) for other in others]
    free, reached = [], 0.0
    for low, high in [*sorted(covered), (1.0, 1.0)]:
        if low > reached:
            free.append((reached, low))
        reached = max(reached, high)
    foot = -float(start @ along) / length**2
    nearest = [start + along * min(max(foot, low), high) for low, high in free]
    return min((math.hypot(*point) for point in nearest), default=math.inf)


def _covered_share(
    start: NDArray[np.float64], end: NDArray[np.float64], outline: NDArray[np.float64]
) -> tuple[float, float]:
    """Interval of a segment within a convex outline, as shares of its length.

    Equal ends mean that no part of it is within. The segment is clipped at one side after the other
    (Cyrus and Beck).
    """
    first, last = clearances(np.stack([start, end]), outline)
    low, high = 0.0, 1.0
    for a, b in zip(first, last, strict=True):
        if a > 0 and b > 0:
            return 0.0, 0.0
        if a > 0:
            low = max(low, a / (a - b))
        elif b > 0:
            high = min(high, a / (a - b))
    return (low, high) if low < high else (0.0, 0.0)
