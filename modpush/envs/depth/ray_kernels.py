"""Compiled ray casting: solids into an image, and at single pixels."""

import math

import numpy as np
from numpy.typing import NDArray

from modpush._kernels import njit
from modpush.geometry.shapes import KINDS

BOX, CYLINDER, CAPSULE, PRISM = range(len(KINDS))
_MISS = np.inf

Floats = NDArray[np.float64]


@njit(error_model="numpy")
def hit(kind: int, size: Floats, planes: Floats, origin: Floats, ray: Floats) -> float:
    """Ray parameter of the first entry into the solid, inf where it misses."""
    if kind == BOX:
        return hit_box(origin, ray, size)
    if kind == PRISM:
        near, far = _slab(origin[2], ray[2], size[2], 0.0, np.inf)
        for i in range(len(planes)):
            nx, ny, distance = planes[i]
            if nx == 0.0 and ny == 0.0:
                break
            along = nx * ray[0] + ny * ray[1]
            gap = distance - nx * origin[0] - ny * origin[1]
            if abs(along) < 1e-12:
                if gap < 0:
                    return _MISS
            elif along < 0:
                near = max(near, gap / along)
            else:
                far = min(far, gap / along)
        return near if near <= far else _MISS
    near, far = _tube(origin, ray, size[0])
    near, far = _slab(origin[2], ray[2], size[1], near, far)
    best = near if near <= far else _MISS
    if kind == CAPSULE:
        best = min(best, _ball(origin, ray, size[0], size[1]))
        best = min(best, _ball(origin, ray, size[0], -size[1]))
    return best


@njit(error_model="numpy", inline="always")
def hit_box(origin: Floats, ray: Floats, size: Floats) -> float:
    near, far = _slab(origin[0], ray[0], size[0], 0.0, np.inf)
    near, far = _slab(origin[1], ray[1], size[1], near, far)
    near, far = _slab(origin[2], ray[2], size[2], near, far)
    return near if near <= far else _MISS


@njit(error_model="numpy", inline="always")
def _slab(origin: float, ray: float, half: float, near: float, far: float) -> tuple[float, float]:
    """Cut an interval of the ray to |coordinate| <= half."""
    if abs(ray) < 1e-12:
        if abs(origin) > half:
            return np.inf, -np.inf
        return near, far
    first, second = (-half - origin) / ray, (half - origin) / ray
    if first > second:
        first, second = second, first
    return max(near, first), min(far, second)


@njit(error_model="numpy")
def _tube(origin: Floats, ray: Floats, radius: float) -> tuple[float, float]:
    """Interval of the ray within an endless cylinder about z."""
    a = ray[0] * ray[0] + ray[1] * ray[1]
    b = origin[0] * ray[0] + origin[1] * ray[1]
    c = origin[0] * origin[0] + origin[1] * origin[1] - radius * radius
    if a < 1e-12:
        return (0.0, np.inf) if c <= 0 else (np.inf, -np.inf)
    inside = b * b - a * c
    if inside < 0:
        return np.inf, -np.inf
    root = math.sqrt(inside)
    return max(0.0, (-b - root) / a), (-b + root) / a


@njit(error_model="numpy")
def _ball(origin: Floats, ray: Floats, radius: float, height: float) -> float:
    """First entry into a ball on the z axis."""
    oz = origin[2] - height
    a = ray[0] * ray[0] + ray[1] * ray[1] + ray[2] * ray[2]
    b = origin[0] * ray[0] + origin[1] * ray[1] + oz * ray[2]
    c = origin[0] * origin[0] + origin[1] * origin[1] + oz * oz - radius * radius
    inside = b * b - a * c
    if inside < 0:
        return _MISS
    t = (-b - math.sqrt(inside)) / a
    return t if t > 0 else _MISS


@njit(error_model="numpy")
def draw_solids(
    depth: NDArray[np.float32],
    segmentation: NDArray[np.uint8],
    kind: NDArray[np.int64],
    size: Floats,
    planes: Floats,
    rotation: Floats,
    position: Floats,
    poses: Floats,
    label: int,
    pinhole: Floats,
) -> None:
    height, width = depth.shape
    n = len(kind)
    origin, ray = np.empty(3), np.empty(3)
    turned, center, bounds = np.empty((n, 3, 3)), np.empty((n, 3)), np.empty((n, 5))
    corners, left, right = np.empty((n, 8, 2)), np.empty(height), np.empty(height)
    for k in range(n):
        _place(poses[min(k, len(poses) - 1)], rotation[k], position[k], turned[k], center[k])
        bounds[k] = _bounds(kind[k], size[k], turned[k], center[k], pinhole, corners[k])
    # Nearest first, so that what is hidden behind is not cast at.
    for k in np.argsort(bounds[:, 4]):
        u0, v0 = max(math.floor(bounds[k, 0]), 0), max(math.floor(bounds[k, 2]), 0)
        u1, v1 = min(math.ceil(bounds[k, 1]), width - 1), min(math.ceil(bounds[k, 3]), height - 1)
        if u0 > u1 or v0 > v1:
            continue
        # Taken out of the loop over pixels: a view of an array costs more there than the ray.
        R, nearest, what, extent, sides = turned[k], bounds[k, 4], kind[k], size[k], planes[k]
        dx, dy, dz = pinhole[0] - center[k, 0], pinhole[1] - center[k, 1], pinhole[2] - center[k, 2]
        _into_local(R, dx, dy, dz, origin)
        _row_spans(corners[k], nearest, u0, u1, int(v0), int(v1), left, right)
        for v in range(int(v0), int(v1) + 1):
            dx = -(v - pinhole[5]) / pinhole[3]
            for u in range(int(left[v]), int(right[v]) + 1):
                if depth[v, u] <= nearest:
                    continue
                dy = -(u - pinhole[4]) / pinhole[3]
                _into_local(R, dx, dy, -1.0, ray)
                # Boxes are most of what is drawn; without the call they take a third of the time.
                if what == BOX:
                    t = hit_box(origin, ray, extent)
                else:
                    t = hit(what, extent, sides, origin, ray)
                if t < depth[v, u]:
                    depth[v, u] = t
                    segmentation[v, u] = label


@njit(error_model="numpy")
def _place(pose: Floats, rotation: Floats, position: Floats, R: Floats, center: Floats) -> None:
    """Rotation and centre of a primitive in the base frame, from its body's pose."""
    w, x, y, z = pose[3], pose[4], pose[5], pose[6]
    B = np.empty((3, 3))
    B[0, 0], B[0, 1], B[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    B[1, 0], B[1, 1], B[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    B[2, 0], B[2, 1], B[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    for i in range(3):
        center[i] = pose[i]
        for j in range(3):
            center[i] += B[i, j] * position[j]
            R[i, j] = 0.0
            for m in range(3):
                R[i, j] += B[i, m] * rotation[m, j]


@njit(error_model="numpy", inline="always")
def _into_local(R: Floats, x: float, y: float, z: float, out: Floats) -> None:
    """R^T (x, y, z)."""
    for j in range(3):
        out[j] = R[0, j] * x + R[1, j] * y + R[2, j] * z


@njit(error_model="numpy")
def _bounds(
    kind: int, size: Floats, R: Floats, position: Floats, pinhole: Floats, corners: Floats
) -> tuple[float, float, float, float, float]:
    """Pixel rectangle (u0, u1, v0, v1) and least depth of the solid's own bounding box.

    Writes the pixels of its corners, `[8, 2]`. A least depth of 0 means that no rectangle holds it.
    """
    hx, hy, hz = _half_extents(kind, size)
    u0, u1, v0, v1, nearest = np.inf, -np.inf, np.inf, -np.inf, np.inf
    for corner in range(8):
        x = hx if corner & 1 else -hx
        y = hy if corner & 2 else -hy
        z = hz if corner & 4 else -hz
        wx = R[0, 0] * x + R[0, 1] * y + R[0, 2] * z + position[0]
        wy = R[1, 0] * x + R[1, 1] * y + R[1, 2] * z + position[1]
        wz = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z + position[2]
        ahead = pinhole[2] - wz
        if ahead <= 1e-6:  # beside or above the camera: no rectangle holds it
            return -1e9, 1e9, -1e9, 1e9, 0.0
        nearest = min(nearest, ahead)
        scale = pinhole[3] / ahead
        u, v = pinhole[4] - (wy - pinhole[1]) * scale, pinhole[5] - (wx - pinhole[0]) * scale
        corners[corner, 0], corners[corner, 1] = u, v
        u0, u1, v0, v1 = min(u0, u), max(u1, u), min(v0, v), max(v1, v)
    return u0, u1, v0, v1, nearest


@njit(error_model="numpy")
def _row_spans(
    corners: Floats,
    nearest: float,
    u0: float,
    u1: float,
    v0: int,
    v1: int,
    left: Floats,
    right: Floats,
) -> None:
    """Per image row the columns within the corners' convex hull: `left[v]` to `right[v]`.

    The hull's sides are among the 28 lines between two corners, and none of these leaves it.
    """
    for v in range(v0, v1 + 1):
        left[v], right[v] = (u0, u1) if nearest == 0.0 else (np.inf, -np.inf)
    if nearest == 0.0:
        return
    for i in range(8):
        for j in range(i):
            ua, va, ub, vb = corners[i, 0], corners[i, 1], corners[j, 0], corners[j, 1]
            if va > vb:
                ua, va, ub, vb = ub, vb, ua, va
            slope = (ub - ua) / (vb - va) if vb > va else 0.0
            for v in range(max(math.ceil(va), v0), min(math.floor(vb), v1) + 1):
                u = ua + (v - va) * slope
                left[v], right[v] = min(left[v], u), max(right[v], u)
    for v in range(v0, v1 + 1):
        if left[v] > right[v]:  # no corner on either side of this row's centres
            left[v], right[v] = 0.0, -1.0
        else:
            left[v], right[v] = max(math.floor(left[v]), u0), min(math.ceil(right[v]), u1)


@njit(error_model="numpy")
def _half_extents(kind: int, size: Floats) -> tuple[float, float, float]:
    if kind == CYLINDER:
        return size[0], size[0], size[1]
    if kind == CAPSULE:
        return size[0], size[0], size[1] + size[0]
    return size[0], size[1], size[2]
