"""Grids as rows of bits: finding the blocked cells in a depth image and inflating them, fast."""

from typing import NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from modpush._kernels import BatchKernel, njit
from modpush.geometry.camera import Label

_OBJECT, _ROBOT = int(Label.OBJECT), int(Label.ROBOT)

# Tall enough for all that may stand hidden behind the object or the arm [m].
_TALLEST = 0.08
# The eight cells of a byte of bits, as eight bytes.
_SPREAD = (
    np.unpackbits(np.arange(256, dtype=np.uint8)[:, None], axis=1, bitorder="little")
    .reshape(-1)
    .view(np.uint64)
)


def words_per_row(width: int) -> int:
    """Words of 64 cells that a row of `width` cells needs."""
    return (width + 63) // 64


@njit(nogil=True)
def _set_cell(bits: NDArray, u: float, v: float, height: int, width: int) -> None:
    i, j = int(np.rint(u)), int(np.rint(v))
    if 0 <= i < width and 0 <= j < height:
        bits[j, i >> 6] |= np.uint64(1) << np.uint64(i & 63)


@njit(nogil=True)
def _has_values(row: NDArray, below: float) -> bool:
    """True if values of a row lie between 0 and `below`; without branches, so that it is vectorised."""
    found = 0
    for u in range(row.size):
        found |= int(row[u] > 0.0) & int(row[u] < below)
    return found != 0


class Views(NamedTuple):
    """Camera images and settings of a batch."""

    depth: NDArray  # `[B, H, W]` float32 [m]; values that are not positive and finite mean no measurement
    # `[B, H, W]` uint8, or `[B, 0, 0]`: then what is seen within the object's radius around its centre
    # counts as the object
    segmentation: NDArray
    # `[B, 2]` float32, the object's centre on the table grid [px]; read without a segmentation
    object_uv: NDArray
    object_radius: NDArray  # `[B]` float64 [px], read without a segmentation
    inflation: NDArray  # `[B]` float64, by how much blocked cells are inflated [px]
    # `[B, H, ceil(W / 64)]` uint64: what is kept where object or robot hide the view
    previous: NDArray
    camera_z: float  # Height of the camera [m]
    min_height: float  # Lower things do not block [m]
    upright: bool  # Draw each point where it stands on the table, rather than where it is seen
    keep: NDArray  # `[B]` bool, scenes that get their last grid, if there is one, unseen


@njit(nogil=True)
def find_blocked(b: int, views: Views, bits: NDArray) -> None:
    """Mark the cells below obstacles, that is all that is neither object nor robot, in `bits`."""
    depth, segmentation, object_uv = views.depth[b], views.segmentation[b], views.object_uv[b]
    object_radius, previous = views.object_radius[b], views.previous[b]
    camera_z, min_height, upright = views.camera_z, views.min_height, views.upright
    height, width = depth.shape
    u0, v0 = 0.5 * (width - 1), 0.5 * (height - 1)
    segmented = segmentation.size > 0
    bits[:] = 0
    hidden = np.zeros_like(bits)
    deepest = camera_z - min_height
    for v in range(height):
        row = depth[v]
        if not _has_values(row, deepest):  # most rows of most images
            continue
        for u in range(width):
            d = row[u]
            if not 0.0 < d < deepest:
                continue
            if segmented and (segmentation[v, u] == _OBJECT or segmentation[v, u] == _ROBOT):
                # Hidden is the line of sight from the table up to the tallest thing.
                shift = max(abs(u - u0), abs(v - v0)) * _TALLEST / camera_z
                steps = int(np.ceil(shift)) if upright else 0
                for k in range(steps + 1):
                    near = 1.0 - (_TALLEST / camera_z * k / steps if steps else 0.0)
                    _set_cell(hidden, u0 + (u - u0) * near, v0 + (v - v0) * near, height, width)
                continue
            scale = d / camera_z
            foot_u, foot_v = u0 + (u - u0) * scale, v0 + (v - v0) * scale
            if not segmented:
                du, dv = foot_u - object_uv[0], foot_v - object_uv[1]
                if du * du + dv * dv <= object_radius * object_radius:
                    continue
            if upright:
                _set_cell(bits, foot_u, foot_v, height, width)
            else:
                _set_cell(bits, u, v, height, width)
    for v in range(height):
        for w in range(bits.shape[1]):
            bits[v, w] |= hidden[v, w] & previous[v, w]


@njit(nogil=True)
def _widen(bits: NDArray) -> None:
    """Widen every blocked run by one cell to the left and to the right, in place."""
    one, top = np.uint64(1), np.uint64(63)
    words = bits.shape[1]
    for v in range(bits.shape[0]):
        carried = np.uint64(0)
        for w in range(words):
            word = bits[v, w]
            after = bits[v, w + 1] if w + 1 < words else np.uint64(0)
            bits[v, w] = word | (word << one) | (word >> one) | carried | (after << top)
            carried = word >> top


@njit(nogil=True)
def inflate_bits(bits: NDArray, radius: float, inflated: NDArray) -> None:
    """Block all cells whose centre is within a radius [px] of a blocked cell's centre; exact.

    Both grids are `[H, N]` uint64; `bits` serves as scratch.
    """
    height, words = bits.shape
    reach = int(np.floor(radius + 1e-9))
    inflated[:] = 0
    for half_width in range(reach + 1):
        if half_width > 0:
            _widen(bits)
        for dy in range(reach + 1):
            # The disc's row dy reaches so far to either side: a row of the map, widened so often.
            square = radius * radius - dy * dy + 1e-9
            if square < 0 or int(np.floor(np.sqrt(square))) != half_width:
                continue
            for v in range(height):
                for w in range(words):
                    word = bits[v, w]
                    if word == 0:
                        continue
                    if v + dy < height:
                        inflated[v + dy, w] |= word
                    if v - dy >= 0:
                        inflated[v - dy, w] |= word


@njit(nogil=True)
def pack_cells(cells: NDArray, bits: NDArray) -> None:
    """`[H, W]` uint8 cells, 0 or 1, to `[H, ceil(W / 64)]` uint64 bits, overwritten."""
    bits[:] = 0
    for v in range(cells.shape[0]):
        for u in range(cells.shape[1]):
            bits[v, u >> 6] |= np.uint64(cells[v, u]) << np.uint64(u & 63)


@njit(nogil=True)
def unpack_cells(bits: NDArray, cells: NDArray) -> None:
    """`[H, ceil(W / 64)]` uint64 bits to `[H, W]` uint8 cells, overwritten with 0 and 1."""
    height, width = cells.shape
    if width % 8 == 0:
        packed = bits.view(np.uint8)
        eights = cells.view(np.uint64)
        for v in range(height):
            for k in range(width // 8):
                eights[v, k] = _SPREAD[packed[v, k]]
        return
    for v in range(height):
        for u in range(width):
            cells[v, u] = (bits[v, u >> 6] >> np.uint64(u & 63)) & np.uint64(1)


class Inflated(NamedTuple):
    """Cache of the last inflated grid of each scene of the batch."""

    bits: NDArray  # `[B, H, ceil(W / 64)]` uint64, the cells before inflation
    radius: NDArray  # `[B]` float64, by how much they were inflated [px]; -1 before the first time
    cells: NDArray  # `[B, H, W]` uint8, the cells after inflation


def empty_inflated(batch: int, height: int, width: int) -> Inflated:
    """An empty cache for the grids of a batch."""
    return Inflated(
        bits=np.zeros((batch, height, words_per_row(width)), dtype=np.uint64),
        radius=np.full(batch, -1.0),
        cells=np.zeros((batch, height, width), dtype=np.uint8),
    )


@njit(nogil=True)
def inflate_one(b: int, cells: NDArray, radius: NDArray, out: NDArray) -> None:
    """Inflate scene b: `[B, H, W]` uint8 cells by `[B]` radii [px]."""
    words = (cells.shape[2] + 63) // 64
    bits = np.empty((cells.shape[1], words), dtype=np.uint64)
    inflated = np.empty_like(bits)
    pack_cells(cells[b], bits)
    inflate_bits(bits, radius[b], inflated)
    unpack_cells(inflated, out[b])


@BatchKernel
def inflate_all(batch: int, cells: NDArray, radius: NDArray, out: NDArray) -> None:
    """Inflate all scenes."""
    for b in prange(batch):
        inflate_one(b, cells, radius, out)


@njit(nogil=True)
def observe_one(
    b: int, views: Views, last: Inflated, bits: NDArray, changed: NDArray, out: NDArray
) -> None:
    """Scene b from depth to inflated cells; the cached grid is used where it is valid or to be kept.

    `bits` `[B, H, ceil(W / 64)]` is overwritten with the cells before inflation, `changed` `[B]` with
    True where the cells were inflated, and `out` `[B, H, W]` uint8 with the inflated cells.
    """
    if views.keep[b] and last.radius[b] >= 0.0:
        bits[b] = last.bits[b]
        changed[b] = False
        out[b] = last.cells[b]
        return
    find_blocked(b, views, bits[b])
    same = last.radius[b] == views.inflation[b]
    for v in range(bits.shape[1]):
        for w in range(bits.shape[2]):
            same = same and last.bits[b, v, w] == bits[b, v, w]
    changed[b] = not same
    if not same:
        last.bits[b] = bits[b]
        last.radius[b] = views.inflation[b]
        scratch, inflated = bits[b].copy(), np.empty_like(bits[b])
        inflate_bits(scratch, views.inflation[b], inflated)
        unpack_cells(inflated, last.cells[b])
    out[b] = last.cells[b]


@BatchKernel
def observe_all(
    batch: int, views: Views, last: Inflated, bits: NDArray, changed: NDArray, out: NDArray
) -> None:
    """All scenes from depth to inflated cells; arguments as in `observe_one`."""
    for b in prange(batch):
        observe_one(b, views, last, bits, changed, out)
