"""Compiled sampling of local windows from bird's-eye images.

In this file pixel edges are at integers, so that cutting off the fraction finds the pixel. Loops
read arrays themselves: passing an array to a function at each pixel costs more than all the rest.
"""

import math

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from modpush.planners.grid import SEGMENT_OBJECT, SEGMENT_ROBOT

_HEIGHT_TOLERANCE = 0.004
"""Two heights this near are of one surface [m]; also what counts as the bare table."""
_MAX_LOOKS = 8
_REMOVED, _OUTSIDE = -1.0, -2.0


@njit(cache=True, nogil=True, error_model="numpy")
def _see(
    b: int,
    depth: NDArray,
    segmentation: NDArray,
    pose: NDArray,
    camera: NDArray,
    out: NDArray,
) -> None:
    """Write the height that is seen on the table plane [m], or `_REMOVED`, or `_OUTSIDE`."""
    camera_z, rows, columns, size = camera[2], depth.shape[1], depth.shape[2], out.shape[1]
    to_pixel, half = camera[3] / camera_z, 0.5 * (size - 1)
    cos, sin = math.cos(pose[b, 2]), math.sin(pose[b, 2])
    u0 = camera[4] + 0.5 - (pose[b, 1] - camera[1]) * to_pixel
    v0 = camera[5] + 0.5 - (pose[b, 0] - camera[0]) * to_pixel
    for i in range(size):
        u_row, v_row = u0 - sin * (half - i), v0 - cos * (half - i)
        for j in range(size):
            u, v = u_row - cos * (half - j), v_row + sin * (half - j)
            if u < 0.0 or v < 0.0 or u >= columns or v >= rows:
                out[b, i, j] = _OUTSIDE
                continue
            row, column = np.uint32(v), np.uint32(u)
            label, seen = segmentation[b, row, column], depth[b, row, column]
            if label == SEGMENT_OBJECT or label == SEGMENT_ROBOT:  # noqa: SIM109  (`in` costs half the time again)
                out[b, i, j] = _REMOVED
            elif 0.0 < seen < camera_z - 1e-6:  # less is rounding
                out[b, i, j] = camera_z - seen
            else:  # the table, or nothing was seen there (0, NaN)
                out[b, i, j] = 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def _set_upright(
    b: int,
    depth: NDArray,
    segmentation: NDArray,
    pose: NDArray,
    camera: NDArray,
    top: float,
    out: NDArray,
) -> None:
    """Replace heights where they are seen by heights where they stand.

    The point at height z over a table point is seen camera_z / (camera_z - z) times as far from the
    image's centre. We look for a height that is seen where it should be, from the top down; a table
    point in an obstacle's shadow has none. What stands on the table is seen at its foot too, so
    there is nothing to look for where the foot's pixel sees the table.
    """
    camera_z, rows, columns, size = camera[2], depth.shape[1], depth.shape[2], out.shape[1]
    to_pixel, half = camera[3] / camera_z, 0.5 * (size - 1)
    cos, sin = math.cos(pose[b, 2]), math.sin(pose[b, 2])
    du0, dv0 = -(pose[b, 1] - camera[1]) * to_pixel, -(pose[b, 0] - camera[0]) * to_pixel
    for i in range(size):
        for j in range(size):
            foot = out[b, i, j]
            if foot == _OUTSIDE or 0.0 <= foot <= _HEIGHT_TOLERANCE:
                continue
            du = du0 - sin * (half - i) - cos * (half - j)
            dv = dv0 - cos * (half - i) + sin * (half - j)
            z, fallen, height = top, False, 0.0
            for _ in range(_MAX_LOOKS):
                scale = camera_z / (camera_z - z)
                u, v = camera[4] + 0.5 + du * scale, camera[5] + 0.5 + dv * scale
                if u < 0.0 or v < 0.0 or u >= columns or v >= rows:
                    height = max(foot, 0.0)
                    break
                row, column = np.uint32(v), np.uint32(u)
                label, seen = segmentation[b, row, column], camera_z - depth[b, row, column]
                if label == SEGMENT_OBJECT or label == SEGMENT_ROBOT or not seen < camera_z:  # noqa: SIM109  (`in` costs half the time again)
                    seen = 0.0
                if (seen >= z and z == top) or (
                    abs(seen - z) <= _HEIGHT_TOLERANCE and seen > _HEIGHT_TOLERANCE
                ):
                    height = seen
                    break
                if seen > _HEIGHT_TOLERANCE:
                    z = min(seen, top)
                elif fallen or foot <= _HEIGHT_TOLERANCE:
                    break
                else:  # looked past the outer edge, or at the object: once more from below
                    fallen, z = True, min(foot, top)
            out[b, i, j] = height


@njit(cache=True, nogil=True, error_model="numpy")
def window_one(
    b: int,
    depth: NDArray,
    segmentation: NDArray,
    pose: NDArray,
    camera: NDArray,
    top: float,
    outside: float,
    upright: bool,
    out: NDArray,
) -> None:
    """Write the window of scene b.

    Args:
        b: Scene.
        depth: `[B, H, W]` float32 [m].
        segmentation: `[B, H, W]` uint8.
        pose: `[B, 3]` float64 (x, y, yaw) of the window's frame, base frame.
        camera: `[6]` float64, camera's x, y, z [m], focal length, principal point (u, v) [px].
        top: Height that is written as 1 [m].
        outside: Written where the image ends.
        upright: Write heights where they stand, not where they are seen.
        out: `[B, S, S]` float32.
    """
    _see(b, depth, segmentation, pose, camera, out)
    if upright:
        _set_upright(b, depth, segmentation, pose, camera, top, out)
    scale = np.float32(1.0 / top)
    for i in range(out.shape[1]):
        for j in range(out.shape[2]):
            height = out[b, i, j]
            value = min(max(height * scale, np.float32(0.0)), np.float32(1.0))
            out[b, i, j] = np.float32(outside) if height == _OUTSIDE else value


@njit(cache=True, nogil=True, error_model="numpy", parallel=True)
def window_many(
    batch: int,
    depth: NDArray,
    segmentation: NDArray,
    pose: NDArray,
    camera: NDArray,
    top: float,
    outside: float,
    upright: bool,
    out: NDArray,
) -> None:
    """All scenes' windows, on several threads; arguments as in `window_one`."""
    for b in prange(batch):
        window_one(b, depth, segmentation, pose, camera, top, outside, upright, out)
