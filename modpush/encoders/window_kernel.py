"""Compiled sampling of local windows from bird's-eye images.

In this file pixel edges are at integers, so that truncation finds the pixel. Loops index arrays
directly: passing an array to a function at each pixel costs more than all the rest. Arithmetic and
reading are separate, since the compiler vectorises only loops without the latter.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from modpush._kernels import BatchKernel, njit
from modpush.geometry.camera import Label

_HEIGHT_TOLERANCE = np.float32(0.004)
"""Largest difference of heights of one surface, and largest height of the bare table [m]."""
_FLAT = np.float32(1e-5)
"""Largest difference of depths of one level surface, from rounding [m]."""
_MAX_LOOKS = 8
"""Largest number of heights that are tried over one table point."""
_REMOVED, _OUTSIDE = np.float32(-1.0), np.float32(-2.0)
_OBJECT, _ROBOT = np.uint8(Label.OBJECT), np.uint8(Label.ROBOT)


class Pinhole(NamedTuple):
    """The numbers of a `Camera`."""

    x: float  # Position along x in the robot's base frame [m]
    y: float  # Position along y in the robot's base frame [m]
    z: float  # Height over the table [m]
    focal_length: float  # Focal length [px]
    u: float  # Column of the principal point [px]
    v: float  # Row of the principal point [px]


@njit(nogil=True, error_model="numpy")
def _find_pixels(
    pose: NDArray, camera: Pinhole, step: float, shape: tuple[int, int], index: NDArray
) -> tuple:
    """Write the image pixel of each window pixel at table height; -1 beyond the image.

    A window pixel is as long as `step` of the image's. Returns the offset of the window's first pixel
    from the principal point, and the offsets from column to column and from row to row: u and v of
    each [px].
    """
    (rows, columns), size = shape, index.shape[0]
    to_pixel, half = camera.focal_length / camera.z, 0.5 * (size - 1)
    cos, sin = step * math.cos(pose[2]), step * math.sin(pose[2])
    du, dv = -(pose[1] - camera.y) * to_pixel, -(pose[0] - camera.x) * to_pixel
    reach = half * (abs(cos) + abs(sin)) + 1.0  # from the middle to the furthest pixel
    u, v = camera.u + 0.5 + du, camera.v + 0.5 + dv
    whole = reach <= u <= columns - reach and reach <= v <= rows - reach
    du0, dv0 = du - (sin + cos) * half, dv - (cos - sin) * half
    for i in range(size):
        u0, v0 = camera.u + 0.5 + du0 + sin * i, camera.v + 0.5 + dv0 + cos * i
        if whole:
            for j in range(size):
                u, v = u0 + cos * j, v0 - sin * j
                index[i, j] = np.int32(v) * np.int32(columns) + np.int32(u)
        else:
            for j in range(size):
                u, v = u0 + cos * j, v0 - sin * j
                inside = u >= 0.0 and v >= 0.0 and u < columns and v < rows
                pixel = np.int32(v) * np.int32(columns) + np.int32(u)
                index[i, j] = pixel if inside else np.int32(-1)
    return du0, dv0, cos, -sin, sin, cos


@njit(nogil=True, error_model="numpy")
def _read_heights(
    index: NDArray, image: NDArray, labels: NDArray, camera_z: float, out: NDArray
) -> None:
    """Write the height in each pixel [m], or `_REMOVED`, or `_OUTSIDE`."""
    table_depth, zero = np.float32(camera_z), np.float32(0.0)
    table = np.float32(camera_z - 1e-6)  # less is rounding
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            if index[i, j] < 0:
                out[i, j] = _OUTSIDE
                continue
            pixel = np.uint32(index[i, j])
            seen, label = image[pixel], labels[pixel]
            # The table, or no measurement (0, NaN).
            height = table_depth - seen if zero < seen < table else zero
            out[i, j] = _REMOVED if label == _OBJECT or label == _ROBOT else height  # noqa: SIM109 (`in` costs half the time again)


@njit(nogil=True, error_model="numpy")
def _set_upright(
    index: NDArray,
    image: NDArray,
    labels: NDArray,
    shape: tuple[int, int],
    offsets: tuple,
    camera: Pinhole,
    top: float,
    out: NDArray,
) -> None:
    """Move heights from where they appear in the image to where they stand.

    The point at height z over a table point is seen camera_z / (camera_z - z) times as far from the
    image's centre. A height is searched that is seen where it should be, from the top down; a table
    point in an obstacle's shadow has none. What stands on the table is seen at its foot too, so that
    nothing is searched where the foot's pixel shows the table, nor where the foot and the pixel at
    which its height would be seen show one level top. (Level, because along the side of an obstacle
    two pixels may show one height that is not its own.) One function, since splitting it costs a
    tenth of its time.
    """
    rows, columns = shape
    du0, dv0, du_column, dv_column, du_row, dv_row = offsets
    camera_z, u_centre, v_centre = camera.z, camera.u + 0.5, camera.v + 0.5
    seen_at = np.empty(out.shape[1], np.int32)  # where a row's heights would be seen, -1 beyond
    width, length = float(columns), float(rows)
    row_below, before_last_row = np.uint32(columns), (rows - 1) * columns - 1
    for i in range(out.shape[0]):
        num_bare = 0
        for j in range(out.shape[1]):
            num_bare += np.float32(0.0) <= out[i, j] <= _HEIGHT_TOLERANCE
        if num_bare == out.shape[1]:  # most rows
            continue
        du_first, dv_first = du0 + i * du_row, dv0 + i * dv_row
        for j in range(out.shape[1]):
            scale = camera_z / (camera_z - out[i, j])
            u = u_centre + (du_first + j * du_column) * scale
            v = v_centre + (dv_first + j * dv_column) * scale
            inside = u >= 0.0 and v >= 0.0 and u < width and v < length
            at = np.int32(v) * np.int32(columns) + np.int32(u)
            seen_at[j] = at if inside else np.int32(-1)
        for j in range(out.shape[1]):
            foot = out[i, j]
            if foot == _OUTSIDE or np.float32(0.0) <= foot <= _HEIGHT_TOLERANCE:
                continue
            if seen_at[j] >= 0 and 0.0 <= foot <= top and index[i, j] < before_last_row:
                here, pixel = np.uint32(index[i, j]), np.uint32(seen_at[j])
                depth, label = image[here], labels[pixel]
                if (
                    abs(image[pixel] - depth) <= _FLAT
                    and abs(image[here + np.uint32(1)] - depth) <= _FLAT
                    and abs(image[here + row_below] - depth) <= _FLAT
                    and label != _OBJECT
                    and label != _ROBOT
                ):
                    out[i, j] = camera_z - depth
                    continue
            du, dv = du_first + j * du_column, dv_first + j * dv_column
            z, fallen, height = top, False, 0.0
            for _ in range(_MAX_LOOKS):
                scale = camera_z / (camera_z - z)
                u, v = u_centre + du * scale, v_centre + dv * scale
                if u < 0.0 or v < 0.0 or u >= width or v >= length:
                    height = max(foot, 0.0)
                    break
                pixel = np.uint32(v) * np.uint32(columns) + np.uint32(u)
                label, seen = labels[pixel], camera_z - image[pixel]
                if label == _OBJECT or label == _ROBOT or not seen < camera_z:  # noqa: SIM109
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
                else:  # beyond the outer edge, or at the object: search once more from below
                    fallen, z = True, min(foot, top)
            out[i, j] = height


@njit(nogil=True, error_model="numpy")
def window_one(
    b: int,
    depth: NDArray,
    segmentation: NDArray,
    pose: NDArray,
    camera: Pinhole,
    step: float,
    top: float,
    outside: float,
    upright: bool,
    out: NDArray,
) -> None:
    """Write the window of scene b, `[B, S, S]` float32.

    `depth` [m] and `segmentation` are `[B, H, W]`, `pose` is `[B, 3]` of the window's frame. A window
    pixel is `step` pixels of the image wide on the table; the height `top` is written as 1 [m], pixels
    beyond the image as `outside`, and heights where they stand if `upright`.
    """
    shape, size, window = depth.shape[1:], out.shape[1], out[b]
    image, labels = depth[b].ravel(), segmentation[b].ravel()
    index = np.empty((size, size), np.int32)
    offsets = _find_pixels(pose[b], camera, step, shape, index)
    _read_heights(index, image, labels, camera.z, window)
    if upright:
        _set_upright(index, image, labels, shape, offsets, camera, top, window)
    to_value, zero, one = np.float32(1.0 / top), np.float32(0.0), np.float32(1.0)
    for i in range(size):
        for j in range(size):
            value = min(max(window[i, j] * to_value, zero), one)
            window[i, j] = np.float32(outside) if window[i, j] == _OUTSIDE else value


def _windows(
    batch: int,
    depth: NDArray,
    segmentation: NDArray,
    pose: NDArray,
    camera: Pinhole,
    step: float,
    top: float,
    outside: float,
    upright: bool,
    out: NDArray,
) -> None:
    """Write all scenes' windows; arguments as in `window_one`."""
    for b in prange(batch):
        window_one(b, depth, segmentation, pose, camera, step, top, outside, upright, out)


# Fewer scenes take less than a millisecond.
write_windows = BatchKernel(_windows, parallel_from=64, error_model="numpy")
