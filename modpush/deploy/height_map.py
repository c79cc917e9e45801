"""`HeightMap`: what stands on the table beside arm and object, as depth images have shown it so far.

The loops over pixels and cells are compiled.
"""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from modpush._kernels import njit
from modpush._validation import checked_arguments
from modpush.geometry.camera import CAMERA, Camera, cell_centers
from modpush.geometry.camera_model import CameraModel

Floats = NDArray[np.float64]
Image = NDArray[np.float32]

NONE, GOOD, FLYING, ARM = 0, 1, 2, 3
"""Kind of a pixel: without a reading, on a surface, between two surfaces, or perhaps on the arm."""

_SAME_SURFACE = 0.012
"""Largest difference of neighbouring pixels on one surface, per depth."""
_FEWEST = 3  # neighbours on the same surface
_LAYER = 0.008
"""Height of the layer whose points are averaged in a cell [m]."""

_LATEST = 0.3
"""Weight of the latest image in a cell's height. One flying pixel of 4 cm stays below what blocks."""
_TABLE = 0.010
"""Height up to which the table is taken for bare [m]: its unevenness, noise and calibration."""
_TALLEST = 0.20
"""Height above which nothing is kept [m]; obstacles are lower, and what floats there is none."""


class HeightMap:
    """Heights over the table on the grid of the policy's camera.

    Each image adds what it shows, except for the arm and for what the caller says is the pushed object;
    cells that are hidden keep what was seen there before. A cell that was never seen counts as the table.

    Args:
        camera: The depth camera.
        view: The policy's camera; the cells are its pixels projected on the table.
    """

    @checked_arguments
    def __init__(self, camera: CameraModel, view: Camera = CAMERA) -> None:
        self.camera, self.view = camera, view
        shape = view.height, view.width
        self.heights = np.zeros(shape, np.float32)
        """Heights of the cells, without arm and object, `[H, W]` [m]."""
        self.seen = np.zeros(shape, dtype=bool)
        """Cells that were seen, `[H, W]`."""
        self.latest = np.zeros(shape, np.float32)
        """Heights in the latest image, with the object, `[H, W]` [m]."""
        self.shown = np.zeros(shape, dtype=bool)
        """Cells that the latest image shows, `[H, W]`."""
        self._count = np.zeros(shape, np.int32)
        self.centers = cell_centers(view)
        """Centres (x, y) of the cells, `[H, W, 2]` [m]."""
        self.corner = self.centers[0, 0].copy()
        """Centre (x, y) of the first cell [m]."""
        self._origin = np.array(camera.position)
        # Over the table's height something is seen further out by up to so many pixels.
        shift = max(shape) / 2 * _TALLEST / (view.z - _TALLEST)
        self._reach = 2 * math.ceil(shift) + 1

    def reset(self) -> None:
        """Forget what was seen."""
        self.heights[:] = 0.0
        self.seen[:] = False
        self.shown[:] = False

    def look(self, depth: NDArray[np.float32], kind: NDArray[np.uint8]) -> None:
        """Read the heights in an image, without keeping them.

        Args:
            depth: `[H, W]` [m].
            kind: `[H, W]`, what each pixel is, from `sort_pixels`.
        """
        cell = self.view.cell_size
        places = self._origin, self.corner, cell, self.latest, self._count
        _collect_heights(depth, kind, self.camera.rays, *places)
        np.clip(self.latest, 0.0, _TALLEST, out=self.latest)
        np.greater(self._count, 0, out=self.shown)
        self._close_gaps()

    def _close_gaps(self) -> None:
        """Fill cells between seen ones that no pixel has met, and remove single ones that stick out."""
        filled = cv2.morphologyEx(self.latest, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
        around = cv2.boxFilter(self.shown.astype(np.float32), -1, (3, 3), normalize=False)
        gap = ~self.shown & (around >= 5)
        self.latest[gap] = filled[gap]
        self.shown |= gap
        self.latest = cv2.medianBlur(self.latest, 3)

    def keep(self, but: NDArray[np.bool_]) -> None:
        """Keep what the image of the last `look` shows.

        Args:
            but: `[H, W]`, cells whose height is not that of an obstacle: the object's, and around it.
        """
        new = self.shown & ~but
        weight = np.where(self.seen, np.float32(_LATEST), np.float32(1.0))
        self.heights += np.where(new, weight * (self.latest - self.heights), np.float32(0.0))
        self.seen |= new

    def around(self) -> NDArray[np.float32]:
        """Heights up to which table and obstacles reach within a cell of each one, `[H, W]` [m]."""
        solid = np.where(self.heights > _TABLE, self.heights, np.float32(0.0))
        return cv2.dilate(solid, np.ones((3, 3), np.uint8))

    def cells_within(self, x: float, y: float, radius: float) -> NDArray[np.bool_]:
        """Cells whose centre lies within a radius of a point, `[H, W]`."""
        away = self.centers - (x, y)
        return np.einsum("ijk,ijk->ij", away, away) <= radius * radius

    def depth(self) -> NDArray[np.float32]:
        """The depth image that the policy's camera has of what was kept, `[H, W]` [m]."""
        solid = np.where(self.heights > _TABLE, self.heights, np.float32(0.0))
        side = self._reach
        near = cv2.dilate((solid > 0).view(np.uint8), np.ones((side, side), np.uint8))
        depth = np.empty_like(solid)
        view = np.array([self.view.z, *self.view.principal_point])
        _look_down(solid, near, view, depth)
        return depth


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
def _collect_heights(
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
def _look_down(heights: Image, near: NDArray[np.uint8], view: Floats, depth: Image) -> None:
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
