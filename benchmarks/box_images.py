"""Depth images of boxes on the table, for the benchmarks and the tests."""

import numpy as np
from numpy.typing import NDArray

from modpush.geometry import Camera

Box = tuple[float, float, float, float, float]  # x from, x to, y from, y to, height [m]
BAR: Box = (0.47, 0.53, -0.15, 0.15, 0.06)


def render(boxes: list[tuple[Box, int]], camera: Camera) -> tuple[NDArray, NDArray]:
    """Depth `[H, W]` [m] and segmentation of axis-aligned boxes, by rays against slabs."""
    rows, columns = np.mgrid[0 : camera.height, 0 : camera.width].astype(float)
    u0, v0 = camera.principal_point
    ray_x, ray_y = -(rows - v0) / camera.focal_length, -(columns - u0) / camera.focal_length
    depth = np.full(rows.shape, camera.z)
    segments = np.zeros(rows.shape, np.uint8)
    for (x0, x1, y0, y1, height), segment in boxes:
        near = np.full(rows.shape, camera.z - height)
        far = np.full(rows.shape, camera.z)
        for ray, low, high in (
            (ray_x, x0 - camera.x, x1 - camera.x),
            (ray_y, y0 - camera.y, y1 - camera.y),
        ):
            a, b = low / ray, high / ray
            near, far = np.maximum(near, np.minimum(a, b)), np.minimum(far, np.maximum(a, b))
        hit = (near <= far) & (near < depth)
        depth[hit], segments[hit] = near[hit], segment
    return depth.astype(np.float32), segments


def square(x: float, y: float, height: float = 0.05, half: float = 0.025) -> Box:
    """The small cube at (x, y)."""
    return (x - half, x + half, y - half, y + half, height)
