"""Poses (x, y, yaw) at which a footprint covers no blocked pixel, on a grid of poses."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from modpush._kernels import njit
from modpush.planners.kernels.bit_grid import inflate_bits

BLOCKED = np.float32(-1.0)
"""The cost of a blocked pose, less than any other, so that no search improves it."""
_FREE = np.float32(np.inf)
_ROUNDING = 1e-6  # [px], so that a side through pixel centres covers them at every yaw


class PoseGrid(NamedTuple):
    """Positions on a lattice of pixels, with a border of blocked poses around them.

    Pose (row, column) of layer k has the flat index `(k * (rows + 2) + row + 1) * (columns + 2) + column
    + 1`, and the yaw k times the scene's yaw step.
    """

    first_u: int  # Column of the first position [px]
    first_v: int  # Row of the first position [px]
    stride: int  # Distance between neighbouring positions [px]
    rows: int  # Number of rows of positions
    columns: int  # Number of columns of positions


@njit(nogil=True)
def _row_spans(reach: NDArray, yaw: float, spans: NDArray) -> None:
    """Write the first and last column that the footprint covers in rows -m to m around its centre.

    `reach` `[N]` is its extent in N directions of its own [px], the yaw [rad] goes from the image's up
    axis to the left. In rows without a pixel the first of `spans` `[2 * m + 1, 2]` is greater than the
    last.
    """
    count, middle = len(reach), (len(spans) - 1) // 2
    cosine, sine = np.empty(count), np.empty(count)
    for k in range(count):
        angle = yaw + 2.0 * np.pi * k / count
        cosine[k], sine[k] = np.cos(angle), np.sin(angle)
    for i in range(len(spans)):
        low, high, empty = -np.inf, np.inf, False
        for k in range(count):
            # A pixel (du, dv) lies at (x, y) = (-dv, -du): inside if -dv cos - du sin <= reach.
            room = reach[k] + (i - middle) * cosine[k] + _ROUNDING
            if sine[k] > 1e-9:
                low = max(low, -room / sine[k])
            elif sine[k] < -1e-9:
                high = min(high, -room / sine[k])
            elif room < 0.0:
                empty = True
        spans[i, 0], spans[i, 1] = 1, 0
        if not empty and low <= high:
            spans[i, 0], spans[i, 1] = int(np.ceil(low)), int(np.floor(high))


@njit(nogil=True)
def _next_blocked(bits: NDArray, following: NDArray) -> None:
    """Write the first blocked column at or after each pixel, `[H, W]`; the width where there is none."""
    height, width = following.shape
    for v in range(height):
        nearest = width
        for u in range(width - 1, -1, -1):
            if bits[v, u >> 6] >> np.uint64(u & 63) & np.uint64(1):
                nearest = u
            following[v, u] = nearest


@njit(nogil=True)
def _covers(following: NDArray, spans: NDArray, u: int, v: int) -> bool:
    """True if the footprint with its centre in pixel (u, v) covers a blocked pixel."""
    height, width = following.shape
    middle = (len(spans) - 1) // 2
    for i in range(max(0, middle - v), min(len(spans), height + middle - v)):
        first, last = max(u + spans[i, 0], 0), min(u + spans[i, 1], width - 1)
        if first <= last and following[v + i - middle, first] <= last:
            return True
    return False


@njit(nogil=True)
def mark_poses(
    bits: NDArray, width: int, reach: NDArray, yaw_step: float, grid: PoseGrid, cost: NDArray
) -> None:
    """Mark each pose as free (infinite cost) or blocked, in `cost` `[K, rows + 2, columns + 2]` float32.

    `bits` `[H, ceil(W / 64)]` are the blocked pixels of a map `width` wide, beyond which all is free;
    `reach` `[N >= 3]` is the extent of the footprint in N directions [px], and `yaw_step` the yaw
    between two layers [rad].
    """
    height = len(bits)
    farthest = reach.max() / np.cos(np.pi / len(reach))  # of the polygon's corners, or more
    # No footprint reaches beyond the image and back.
    near, inside = np.empty_like(bits), np.empty_like(bits)
    inflate_bits(bits.copy(), min(farthest, float(height + width)), near)
    inflate_bits(bits.copy(), min(reach.min(), float(height + width)), inside)
    following = np.empty((height, width), dtype=np.int16)
    _next_blocked(bits, following)
    spans = np.empty((2 * min(int(farthest), height) + 1, 2), dtype=np.int64)
    cost.fill(BLOCKED)
    for k in range(len(cost)):
        _row_spans(reach, k * yaw_step, spans)
        for row in range(grid.rows):
            v = grid.first_v + row * grid.stride
            for column in range(grid.columns):
                u = grid.first_u + column * grid.stride
                word, bit = u >> 6, np.uint64(u & 63)
                if inside[v, word] >> bit & np.uint64(1):
                    continue
                is_near = near[v, word] >> bit & np.uint64(1)
                if is_near and _covers(following, spans, u, v):
                    continue
                cost[k, row + 1, column + 1] = _FREE
