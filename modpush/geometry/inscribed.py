"""The largest circle about a body's origin within its footprint."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from modpush.geometry.footprint import clearances, outline_of
from modpush.geometry.shapes import Primitive

__all__ = ["inscribed_radius"]

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
