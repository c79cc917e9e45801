"""Entry of a ray into a solid, compiled. Rays are in the axes of the solid, `origin + t ray`."""

import math

import numpy as np
from numpy.typing import NDArray

from modpush._kernels import njit
from modpush.geometry.shapes import KINDS

__all__ = ["BOX", "CAPSULE", "CYLINDER", "hit", "hit_box"]

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
