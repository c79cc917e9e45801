"""Depth images of known solids, by casting the camera's rays at them. Numba, no renderer.

The table is the plane z = 0. Depth is along the optical axis [m], as the rendered camera gives it.
Bodies are drawn one after the other into an image that already holds what is behind them, so that
what stands still is drawn once.
"""

import functools
import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from modpush.geometry.camera import CAMERA, Camera
from modpush.geometry.labels import Label
from modpush.geometry.shapes import KINDS, Primitive

__all__ = [
    "Solids",
    "blank_image",
    "cast_pixels",
    "draw",
    "warmup",
]

_BOX, _CYLINDER, _CAPSULE, _PRISM = range(len(KINDS))
_MAX_SIDES = 16  # of a prism
_MISS = np.inf


@dataclass(frozen=True)
class Solids:
    """Primitives of one body, or of many that stand still, as arrays that the kernels read."""

    kind: NDArray[np.int64]
    """`[n]`, index into `KINDS`."""
    size: NDArray[np.float64]
    """`[n, 3]`, as in `Primitive` [m]."""
    planes: NDArray[np.float64]
    """`[n, 16, 3]`, sides of a prism: outward normal (x, y) and distance; unused rows never cut."""
    rotation: NDArray[np.float64]
    """`[n, 3, 3]`, primitive to body."""
    position: NDArray[np.float64]
    """`[n, 3]`, in the body [m]."""

    @classmethod
    def of(cls, parts: Iterable[Primitive]) -> "Solids":
        """Collect primitives.

        Raises:
            ValueError: If a prism has more than 16 sides.
        """
        parts = tuple(parts)
        planes = np.zeros((len(parts), _MAX_SIDES, 3))
        planes[..., 2] = 1.0
        for i, part in enumerate(parts):
            sides = _side_planes(part)
            if len(sides) > _MAX_SIDES:
                raise ValueError(f"Solids: a prism may have {_MAX_SIDES} sides, got {len(sides)}.")
            planes[i, : len(sides)] = sides
        return cls(
            np.array([KINDS.index(part.kind) for part in parts], dtype=np.int64),
            np.array([part.size for part in parts], dtype=np.float64).reshape(-1, 3),
            planes,
            np.array([part.rotation() for part in parts]).reshape(-1, 3, 3),
            np.array([part.position for part in parts], dtype=np.float64).reshape(-1, 3),
        )

    def __len__(self) -> int:
        return len(self.kind)


def _side_planes(part: Primitive) -> NDArray[np.float64]:
    """Outward normals and distances of a prism's sides, `[m, 3]`."""
    if part.kind != "prism":
        return np.zeros((0, 3))
    outline = np.array(part.outline)
    edge = np.roll(outline, -1, axis=0) - outline
    normal = np.stack([edge[:, 1], -edge[:, 0]], -1) / np.linalg.norm(edge, axis=1)[:, None]
    return np.hstack([normal, (normal * outline).sum(1, keepdims=True)])


def blank_image(camera: Camera = CAMERA) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Depth and segmentation of the bare table, `[H, W]` each."""
    depth = np.full((camera.height, camera.width), camera.z, dtype=np.float32)
    return depth, np.zeros((camera.height, camera.width), dtype=np.uint8)


def draw(
    depth: NDArray[np.float32],
    segmentation: NDArray[np.uint8],
    solids: Solids,
    poses: NDArray[np.float64],
    label: int,
    camera: Camera = CAMERA,
) -> None:
    """Draw solids into an image, in place.

    Args:
        depth: `[H, W]` float32 [m].
        segmentation: `[H, W]` uint8.
        solids: `n` primitives.
        poses: Of the body they all belong to, `[1, 7]`, or of each one's own, `[n, 7]`, float64:
            position [m] and quaternion (w, x, y, z) in the base frame.
        label: Written where the solids are in front, see `Label`.
        camera: The pinhole the image belongs to.
    """
    _draw(depth, segmentation, *_arrays(solids), poses, int(label), _pinhole(camera))


def cast_pixels(
    pixels: NDArray[np.float64],
    groups: Iterable[tuple[Solids, NDArray[np.float64], int]],
    camera: Camera = CAMERA,
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Depth and label at single pixels: what the full image would hold there, without drawing it.

    Args:
        pixels: `[..., 2]` (u, v); any real number, also outside the image.
        groups: Solids, their poses as in `draw`, and their label, in any order.
        camera: The pinhole.

    Returns:
        Depth `[...]` float32 [m] and label `[...]` uint8.
    """
    flat = np.ascontiguousarray(pixels, dtype=np.float64).reshape(-1, 2)
    depth = np.full(len(flat), camera.z, dtype=np.float32)
    labels = np.zeros(len(flat), dtype=np.uint8)
    for solids, poses, label in groups:
        _cast(flat, depth, labels, *_arrays(solids), poses, int(label), _pinhole(camera))
    shape = pixels.shape[:-1]
    return depth.reshape(shape), labels.reshape(shape)


def _arrays(solids: Solids) -> tuple[NDArray[Any], ...]:
    return solids.kind, solids.size, solids.planes, solids.rotation, solids.position


@functools.cache
def _pinhole(camera: Camera) -> NDArray[np.float64]:
    """Position, focal length and principal point as the kernels read them, `[6]`."""
    return np.array([*camera.position, camera.focal_length, *camera.principal_point])


def warmup() -> None:
    """Compile (or load from the cache) every kernel, so that no first call is slow."""
    solids = Solids.of([Primitive(kind="box", size=(0.01, 0.01, 0.01))])
    depth, segmentation = blank_image()
    pose = np.array([[0.5, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]])
    draw(depth, segmentation, solids, pose, Label.OBJECT)
    cast_pixels(np.zeros((1, 2)), [(solids, pose, Label.OBJECT)])


@numba.njit(cache=True, error_model="numpy")
def _draw(depth, segmentation, kind, size, planes, rotation, position, poses, label, pinhole):  # type: ignore[no-untyped-def]
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
                if what == _BOX:
                    t = _hit_box(origin, ray, extent)
                else:
                    t = _hit(what, extent, sides, origin, ray)
                if t < depth[v, u]:
                    depth[v, u] = t
                    segmentation[v, u] = label


@numba.njit(cache=True, error_model="numpy")
def _cast(pixels, depth, labels, kind, size, planes, rotation, position, poses, label, pinhole):  # type: ignore[no-untyped-def]
    origin, ray, R, center = np.empty(3), np.empty(3), np.empty((3, 3)), np.empty(3)
    low, high = np.array([np.inf, np.inf]), np.array([-np.inf, -np.inf])
    corners = np.empty((8, 2))
    for i in range(len(pixels)):
        for axis in range(2):
            low[axis] = min(low[axis], pixels[i, axis])
            high[axis] = max(high[axis], pixels[i, axis])
    for k in range(len(kind)):
        _place(poses[min(k, len(poses) - 1)], rotation[k], position[k], R, center)
        u0, u1, v0, v1, _ = _bounds(kind[k], size[k], R, center, pinhole, corners)
        if u1 < low[0] or u0 > high[0] or v1 < low[1] or v0 > high[1]:
            continue
        what, extent, sides = kind[k], size[k], planes[k]
        _into_local(
            R, pinhole[0] - center[0], pinhole[1] - center[1], pinhole[2] - center[2], origin
        )
        for i in range(len(pixels)):
            u, v = pixels[i]
            if u < u0 or u > u1 or v < v0 or v > v1:
                continue
            _into_local(
                R, -(v - pinhole[5]) / pinhole[3], -(u - pinhole[4]) / pinhole[3], -1.0, ray
            )
            if what == _BOX:
                t = _hit_box(origin, ray, extent)
            else:
                t = _hit(what, extent, sides, origin, ray)
            if t < depth[i]:
                depth[i] = t
                labels[i] = label


@numba.njit(cache=True, error_model="numpy")
def _place(pose, rotation, position, R, center):  # type: ignore[no-untyped-def]
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


@numba.njit(cache=True, error_model="numpy", inline="always")
def _into_local(R, x, y, z, out):  # type: ignore[no-untyped-def]
    """R^T (x, y, z)."""
    for j in range(3):
        out[j] = R[0, j] * x + R[1, j] * y + R[2, j] * z


@numba.njit(cache=True, error_model="numpy")
def _bounds(kind, size, R, position, pinhole, corners):  # type: ignore[no-untyped-def]
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


@numba.njit(cache=True, error_model="numpy")
def _row_spans(corners, nearest, u0, u1, v0, v1, left, right):  # type: ignore[no-untyped-def]
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


@numba.njit(cache=True, error_model="numpy")
def _half_extents(kind, size):  # type: ignore[no-untyped-def]
    if kind == _CYLINDER:
        return size[0], size[0], size[1]
    if kind == _CAPSULE:
        return size[0], size[0], size[1] + size[0]
    return size[0], size[1], size[2]


@numba.njit(cache=True, error_model="numpy")
def _hit(kind, size, planes, origin, ray):  # type: ignore[no-untyped-def]
    """Ray parameter of the first entry into the solid, inf where it misses."""
    if kind == _BOX:
        return _hit_box(origin, ray, size)
    if kind == _PRISM:
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
    if kind == _CAPSULE:
        best = min(best, _ball(origin, ray, size[0], size[1]))
        best = min(best, _ball(origin, ray, size[0], -size[1]))
    return best


@numba.njit(cache=True, error_model="numpy", inline="always")
def _hit_box(origin, ray, size):  # type: ignore[no-untyped-def]
    near, far = _slab(origin[0], ray[0], size[0], 0.0, np.inf)
    near, far = _slab(origin[1], ray[1], size[1], near, far)
    near, far = _slab(origin[2], ray[2], size[2], near, far)
    return near if near <= far else _MISS


@numba.njit(cache=True, error_model="numpy", inline="always")
def _slab(origin, ray, half, near, far):  # type: ignore[no-untyped-def]
    """Cut an interval of the ray to |coordinate| <= half."""
    if abs(ray) < 1e-12:
        if abs(origin) > half:
            return np.inf, -np.inf
        return near, far
    first, second = (-half - origin) / ray, (half - origin) / ray
    if first > second:
        first, second = second, first
    return max(near, first), min(far, second)


@numba.njit(cache=True, error_model="numpy")
def _tube(origin, ray, radius):  # type: ignore[no-untyped-def]
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


@numba.njit(cache=True, error_model="numpy")
def _ball(origin, ray, radius, height):  # type: ignore[no-untyped-def]
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
