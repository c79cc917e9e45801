"""Cache of each scene's map and its corners between calls of the searches."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from modpush._kernels import njit
from modpush.planners.kernels.visibility import convex_corners, vertex_codes

__all__ = ["MAX_CORNERS", "Maps", "corner_count", "empty_maps", "refresh_map"]

# Searches over corners take time quadratic in their number. A map of ten inflated bars has 440;
# past this number the map is noise, and planners turn to searches over the grid.
MAX_CORNERS = 2048
_UNKNOWN = -1


class Maps(NamedTuple):
    """The last map of each scene of the batch, and quantities computed from it.

    Attributes:
        cells: `[B, H, W]` uint8, the map, 1 where blocked; 255 before the first.
        codes: `[B, H + 1, W + 1]` uint8, see `visibility.vertex_codes`.
        corners: `[B, MAX_CORNERS + 2, 4]` int64, see `visibility.convex_corners`; two rows more for
            a query's ends.
        corner_counts: `[B]` int64, number of corners, `_UNKNOWN` until asked for.
    """

    cells: NDArray
    codes: NDArray
    corners: NDArray
    corner_counts: NDArray


def empty_maps(batch: int, height: int, width: int) -> Maps:
    """An empty cache for the maps of a batch."""
    return Maps(
        cells=np.full((batch, height, width), 255, dtype=np.uint8),
        codes=np.zeros((batch, height + 1, width + 1), dtype=np.uint8),
        corners=np.zeros((batch, MAX_CORNERS + 2, 4), dtype=np.int64),
        corner_counts=np.full(batch, _UNKNOWN, dtype=np.int64),
    )


@njit(nogil=True)
def refresh_map(maps: Maps, b: int, cells: NDArray) -> bool:
    """Store scene b's map; returns True if it differs from the last one."""
    new, old = cells.ravel(), maps.cells[b].ravel()
    difference = np.uint8(0)
    for i in range(new.size):
        difference |= new[i] ^ old[i]
    if difference == 0:
        return False
    old[:] = new
    vertex_codes(maps.cells[b], maps.codes[b])
    maps.corner_counts[b] = _UNKNOWN
    return True


@njit(nogil=True)
def corner_count(maps: Maps, b: int) -> int:
    """Number of scene b's convex corners, which are listed if they have not been."""
    if maps.corner_counts[b] < 0:
        maps.corner_counts[b] = convex_corners(maps.codes[b], maps.corners[b, :MAX_CORNERS])
    return maps.corner_counts[b]
