"""Comparison of a known object's pose with a depth image, and search for the best pose. Compiled.

For each pixel near the object, the depth at which it would show it is compared with what it shows.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from modpush._kernels import njit
from modpush.deploy.height_map import ARM, GOOD
from modpush.deploy.outlines import overlap, padded, place
from modpush.envs.scenes.objects import PushedObject
from modpush.geometry.footprint import outline_of, side_planes, vertical_range

EXPLAINED, UNEXPLAINED, HIDDEN = 0, 1, 2
"""Content of a pixel: the table or a known obstacle; something else; the arm, perhaps."""
BEHIND = 0.010
"""Difference of depths that contradicts a pose [m]: five times the noise at 1 m."""
_OVER_TABLE = 0.009
"""Height over what is known below which a pixel is explained by it [m]."""
_OVERLAP = 0.0015
"""Overlap of tool and object that costs as much as a tenth of the object's pixels [m]."""
_STEP = 0.004
"""First step of the search for a pose, which is halved down to a sixteenth [m]."""

Floats = NDArray[np.float64]
Image = NDArray[np.float32]


class ObjectShape(NamedTuple):
    """The upright parts of an object as the compiled functions read them; a capsule is a cylinder."""

    sides: Floats
    """Outward normal (x, y) and distance from the origin of each part's sides, `[n, m, 3]` [m]."""
    counts: NDArray[np.int64]
    """Number of sides of each part, 0 of a cylinder, `[n]`."""
    circles: Floats
    """Axis (x, y) and radius of each cylinder, `[n, 3]` [m]; radius 0 for other parts."""
    levels: Floats
    """Lower and upper end of each part over the table, `[n, 2]` [m]."""
    outlines: Floats
    """Outline of each part, `[n, k, 2]` [m]."""
    corners: NDArray[np.int64]
    """Number of corners of each outline, `[n]`."""
    radius: float
    """Radius of the circle around the object's footprint [m]."""

    @classmethod
    def of(cls, item: PushedObject) -> "ObjectShape":
        """The shape of an object that stands on the table."""
        n = len(item.parts)
        planes, circles = [np.zeros((0, 3))] * n, np.zeros((n, 3))
        for i, part in enumerate(item.parts):
            if part.kind in ("box", "prism"):
                planes[i] = np.column_stack(side_planes(outline_of(part)))
            else:
                circles[i] = (*part.position[:2], part.size[0])
        levels = np.array([vertical_range(part) for part in item.parts]) + item.height / 2
        outlines = padded(item.footprints(num_arc=24))
        return cls(*padded(planes), circles, levels, *outlines, item.radius)


class Expectation(NamedTuple):
    """Knowledge of an object's pose beside the image."""

    prior: Floats
    """Pose that is expected, `[3]` [m, m, rad]."""
    spread: Floats
    """Standard deviation of it, `[3]` [m, m, rad]."""
    weight: float
    """Number of pixels that the object covers, which sets the weight of all that is no pixel."""
    tool: Floats
    """Outlines of the tool, `[k, n, 2]` [m], which do not overlap with the object."""
    tool_corners: NDArray[np.int64]
    """Number of corners of each."""


@njit(error_model="numpy")
def gather(
    depth: Image,
    kind: NDArray[np.uint8],
    rays: Image,
    origin: Floats,
    box: tuple[int, int, int, int],
    stride: int,
    known: Image,
    corner: Floats,
    cell: float,
    out: Floats,
) -> int:
    """Collect every `stride`-th pixel in a rectangle (u0, v0, u1, v1) of an image; returns their number.

    `known` are the heights up to which table and known obstacles reach around each cell of a grid [m].
    Ray (x, y, z), depth, and what the pixel shows are written to `out` `[n, 5]`.
    """
    n = 0
    u0, v0, u1, v1 = box
    for v in range(v0, v1, stride):
        for u in range(u0, u1, stride):
            if kind[v, u] != ARM and kind[v, u] != GOOD:
                continue
            x, y, z = rays[v, u, 0], rays[v, u, 1], rays[v, u, 2]
            out[n, 0], out[n, 1], out[n, 2], out[n, 3] = x, y, z, depth[v, u]
            out[n, 4] = HIDDEN
            if kind[v, u] == GOOD:
                d = depth[v, u]
                i = int(math.floor((corner[0] - origin[0] - d * x) / cell + 0.5))
                j = int(math.floor((corner[1] - origin[1] - d * y) / cell + 0.5))
                height = np.float32(0.0)
                if 0 <= i < known.shape[0] and 0 <= j < known.shape[1]:
                    height = known[i, j]
                over = origin[2] + d * z > height + _OVER_TABLE
                out[n, 4] = UNEXPLAINED if over else EXPLAINED
            n += 1
            if n == len(out):
                return n
    return n


@njit(error_model="numpy")
def _first_hit(
    origin: tuple[float, float, float], ray: tuple[float, float, float], shape: ObjectShape
) -> float:
    """Depth at which a ray in the object's frame meets it first, inf if it does not [m]."""
    sides, counts, circles, levels = shape.sides, shape.counts, shape.circles, shape.levels
    (ox, oy, oz), (rx, ry, z) = origin, ray
    first = np.inf
    for k in range(len(counts)):
        near, far = (levels[k, 1] - oz) / z, (levels[k, 0] - oz) / z
        if near > far:
            near, far = far, near
        for m in range(counts[k]):
            nx, ny = sides[k, m, 0], sides[k, m, 1]
            rate = nx * rx + ny * ry
            gap = sides[k, m, 2] - nx * ox - ny * oy
            if rate < 0.0:
                near = max(near, gap / rate)
            elif rate > 0.0:
                far = min(far, gap / rate)
            elif gap < 0.0:
                far = -np.inf
        if circles[k, 2] > 0.0:
            cx, cy = ox - circles[k, 0], oy - circles[k, 1]
            a, b = rx * rx + ry * ry, cx * rx + cy * ry
            inside = b * b - a * (cx * cx + cy * cy - circles[k, 2] ** 2)
            if inside < 0.0:
                far = -np.inf
            else:
                root = math.sqrt(inside)
                near, far = max(near, (-b - root) / a), min(far, (-b + root) / a)
        if near <= far:
            first = min(first, near)
    return first


@njit(error_model="numpy")
def compare(
    pose: Floats, pixels: Floats, origin: Floats, shape: ObjectShape
) -> tuple[float, float, int]:
    """Compare a pose of an object with pixels.

    Args:
        pose: x, y, yaw [m, m, rad].
        pixels: `[n, 5]` from `gather`.
        origin: The pinhole [m].
        shape: The object.

    Returns:
        What contradicts the pose, all pixels together; that on the object alone; and the number of pixels
        on the object that show something.
    """
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    dx, dy, oz = origin[0] - pose[0], origin[1] - pose[1], origin[2]
    ox, oy = cos * dx + sin * dy, -sin * dx + cos * dy
    # The ball around the object, by which most rays are told to miss it.
    top, radius = shape.levels[:, 1].max(), shape.radius
    ball_z = oz - 0.5 * top
    outside = ox * ox + oy * oy + ball_z * ball_z - radius * radius - 0.25 * top * top
    total, own, shown = 0.0, 0.0, 0
    for i in range(len(pixels)):
        x, y, z = pixels[i, 0], pixels[i, 1], pixels[i, 2]
        rx, ry = cos * x + sin * y, -sin * x + cos * y
        along = ox * rx + oy * ry + ball_z * z
        first = np.inf
        if along * along > (rx * rx + ry * ry + z * z) * outside:
            first = _first_hit((ox, oy, oz), (rx, ry, z), shape)
        what = int(pixels[i, 4])
        if first == np.inf:
            if what == UNEXPLAINED:
                total += 1.0
            continue
        if what == HIDDEN:
            continue
        behind = (pixels[i, 3] - first) / BEHIND
        if behind < -1.0 and what == EXPLAINED:
            continue  # a known obstacle before it
        shown += 1
        cost = min(1.0, behind * behind)
        total += cost
        own += cost
    return total, own, shown


@njit(error_model="numpy")
def _cost(
    pose: Floats, expected: Expectation, pixels: Floats, origin: Floats, shape: ObjectShape
) -> float:
    """Cost of a pose [px]: contradicting pixels, distance from the prior, and overlap with the tool."""
    total, weight = compare(pose, pixels, origin, shape)[0], expected.weight
    for axis in range(3):
        away = (pose[axis] - expected.prior[axis]) / expected.spread[axis]
        total += 0.03 * weight * away**2
    body = np.empty_like(shape.outlines[0])
    for part in range(len(shape.outlines)):
        n = shape.corners[part]
        place(shape.outlines[part, :n], pose[0], pose[1], pose[2], body[:n])
        for k in range(len(expected.tool)):
            depth = overlap(expected.tool[k, : expected.tool_corners[k]], body[:n])[0]
            if depth > 0.0:
                total += 0.1 * weight * (depth / _OVERLAP) ** 2
    return total


@njit(error_model="numpy")
def best_pose(
    starts: Floats,
    expected: Expectation,
    pixels: Floats,
    origin: Floats,
    shape: ObjectShape,
    keep: int,
) -> Floats:
    """The pose that explains pixels best, `[3]`, by a pattern search from the `keep` best of some poses.

    Args:
        starts: The poses to begin with, `[n, 3]` [m, m, rad].
        expected: Knowledge of the pose beside the pixels.
        pixels: `[n, 5]` from `gather`.
        origin: The pinhole [m].
        shape: The object.
        keep: Number of poses from which is searched.
    """
    first = np.empty(len(starts))
    for i in range(len(starts)):
        first[i] = _cost(starts[i], expected, pixels, origin, shape)
    best, least = starts[0].copy(), np.inf
    trial = np.empty(3)
    for i in np.argsort(first)[:keep]:
        pose, cost, size = starts[i].copy(), first[i], _STEP
        while size > _STEP / 17:
            moved = False
            for axis in range(3):
                for sign in (-1.0, 1.0):
                    trial[:] = pose
                    trial[axis] += sign * (size if axis < 2 else size / shape.radius)
                    found = _cost(trial, expected, pixels, origin, shape)
                    if found < cost - 1e-9:
                        pose[:], cost, moved = trial, found, True
            if not moved:
                size *= 0.5
        if cost < least:
            best[:], least = pose, cost
    return best
