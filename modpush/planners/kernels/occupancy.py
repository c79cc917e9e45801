"""From depth images to inflated grids, for a batch of scenes."""

from typing import NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from modpush._batching import BatchKernel
from modpush._kernels import njit
from modpush.planners.kernels.bit_grid import (
    Views,
    find_blocked,
    inflate_bits,
    pack_cells,
    unpack_cells,
    words_per_row,
)

__all__ = [
    "Inflated",
    "empty_inflated",
    "inflate_all",
    "observe_all",
]


class Inflated(NamedTuple):
    """Cache of the last inflated grid of each scene of the batch.

    Attributes:
        bits: `[B, H, ceil(W / 64)]` uint64, the cells before inflation.
        radius: `[B]` float64, by how much they were inflated [px]; -1 before the first time.
        cells: `[B, H, W]` uint8, the cells after inflation.
    """

    bits: NDArray
    radius: NDArray
    cells: NDArray


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
    """Scene b from depth to inflated cells; the cached grid is used where it is still valid.

    Args:
        b: Scene.
        views: Images and settings.
        last: What was inflated last, kept up to date.
        bits: `[B, H, ceil(W / 64)]` uint64, overwritten with the cells before inflation.
        changed: `[B]` bool, overwritten: True where the cells were inflated.
        out: `[B, H, W]` uint8, overwritten with the inflated cells.
    """
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
