"""The straight line, where it is free."""

import numpy as np
from numba import prange

from modpush._batching import BatchKernel
from modpush._kernels import njit
from modpush.planners.kernels.maps import Maps, refresh_map
from modpush.planners.kernels.paths import PathArrays, Queries, place_ends, write_path
from modpush.planners.kernels.visibility import line_of_sight

__all__ = ["plan_all"]


@njit(nogil=True)
def plan_one(b: int, maps: Maps, queries: Queries, paths: PathArrays) -> None:
    """Plan scene b."""
    x, y = np.empty(2, dtype=np.int64), np.empty(2, dtype=np.int64)
    refresh_map(maps, b, queries.cells[b])
    if not place_ends(maps, b, queries, x, y, paths):
        return
    if line_of_sight(maps.codes[b], x[0], y[0], x[1], y[1]):
        write_path(paths, b, queries, x, y)


@BatchKernel
def plan_all(batch: int, maps: Maps, queries: Queries, paths: PathArrays) -> None:
    """Plan all scenes."""
    for b in prange(batch):
        plan_one(b, maps, queries, paths)
