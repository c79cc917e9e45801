"""Compiled loops over the pixels of a depth image and the cells of the table's grid."""

import numpy as np
from numpy.typing import NDArray

from modpush._kernels import njit

NONE, GOOD, FLYING, ARM = 0, 1, 2, 3
"""Kind of a pixel: without a reading, on a surface, between two surfaces, or perhaps on the arm."""

_SAME_SURFACE = 0.012
"""Largest difference of neighbouring pixels on one surface, per depth."""
_FEWEST = 3  # neighbours on the same surface
_LAYER = 0.008
"""Height of the layer whose points are averaged in a cell [m]."""

Floats = NDArray[np.float64]
Image = NDArray[np.float32]


@njit(error_model="numpy")
def sort_pixels(depth: Image, arm: NDArray[np.bool_], out: NDArray[np.uint8]) -> None:
    """Write what each pixel is."""
    rows, columns = depth.shape
    for v in range(rows):
        for u in range(columns):
            z = depth[v, u]
            if arm[v, u]:
                out[v, u] = ARM
            elif not 0.0 < z < np.inf:
                out[v, u] = NONE
            else:
                near, limit = 0, _SAME_SURFACE * z
                for dv in range(-1, 2):
                    for du in range(-1, 2):
                        b, a = v + dv, u + du
                        if 0 <= b < rows and 0 <= a < columns and abs(depth[b, a] - z) < limit:
                            near += 1
                out[v, u] = GOOD if near > _FEWEST else FLYING


@njit(error_model="numpy")
def collect_heights(
    depth: Image,
    kind: NDArray[np.uint8],
    rays: Image,
    origin: Floats,
    corner: Floats,
    cell: float,
    heights: Image,
    count: NDArray[np.int32],
) -> None:
    """Write the height of the highest surface that is seen in each cell, and its number of pixels.

    Cell (0, 0) has its centre at `corner` (x, y); x falls from row to row, y from column to column.
    """
    rows, columns = heights.shape
    heights[:] = 0.0
    count[:] = 0
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            if kind[v, u] != GOOD:
                continue
            z = depth[v, u]
            i = int(np.floor((corner[0] - origin[0] - z * rays[v, u, 0]) / cell + 0.5))
            j = int(np.floor((corner[1] - origin[1] - z * rays[v, u, 1]) / cell + 0.5))
            if not (0 <= i < rows and 0 <= j < columns):
                continue
            height = np.float32(origin[2] + z * rays[v, u, 2])
            n = count[i, j]
            if n == 0 or height > heights[i, j] + _LAYER:
                heights[i, j], count[i, j] = height, 1
            elif height > heights[i, j] - _LAYER:
                heights[i, j] += (height - heights[i, j]) / (n + 1)
                count[i, j] = n + 1


@njit(error_model="numpy")
def look_down(heights: Image, near: NDArray[np.uint8], view: Floats, depth: Image) -> None:
    """Draw heights over the table as a camera that looks straight down sees them, into `depth` [m].

    `heights` are those over the points that its pixels show, and `near` is not 0 where something may be
    seen before the table, `[H, W]` each; `view` is the camera's height [m] and its principal point (u, v)
    [px].
    """
    rows, columns = heights.shape
    top = np.float32(0.0)
    for i in range(rows):
        for j in range(columns):
            top = max(top, heights[i, j])
    z, u0, v0 = view
    for i in range(rows):
        for j in range(columns):
            depth[i, j] = z
            if near[i, j] == 0:
                continue
            # The ray comes from the middle of the image and ends in this pixel's own cell.
            du, dv = j - u0, i - v0
            away = max(abs(du), abs(dv))
            steps = int(np.ceil(2.0 * away * top / z)) + 1
            fall = top / steps
            for step in range(steps + 1):
                level = top - step * fall
                scale = 1.0 - level / z
                a = int(np.floor(u0 + du * scale + 0.5))
                b = int(np.floor(v0 + dv * scale + 0.5))
                here = heights[b, a]
                if here >= level:
                    depth[i, j] = z - min(here, level + fall)
                    break
