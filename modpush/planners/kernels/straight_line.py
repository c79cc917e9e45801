"""The straight line, where it is free."""

import numpy as np
from numba import prange

from modpush._kernels import njit
from modpush.planners.kernels.maps import Maps, refresh_map
from modpush.planners.kernels.paths import PathArrays, Queries, place_ends, write_path
from modpush.planners.kernels.visibility import line_of_sight

__all__ = ["plan_few", "plan_many"]


@njit(nogil=True)
def plan_one(b: int, maps: Maps, queries: Queries, paths: PathArrays) -> None:
    """Plan scene b."""
    x, y = np.empty(2, dtype=np.int64), np.empty(2, dtype=np.int64)
    refresh_map(maps, b, queries.cells[b])
    if not place_ends(maps, b, queries, x, y, paths):
        return
    if line_of_sight(maps.codes[b], x[0], y[0], x[1], y[1]):
        write_path(paths, b, queries, x, y)


@njit(nogil=True)
def plan_few(batch: int, maps: Maps, queries: Queries, paths: PathArrays) -> None:
    """Plan all scenes, one after the other."""
    for b in range(batch):
        plan_one(b, maps, queries, paths)


@njit(nogil=True, parallel=True)
def plan_many(batch: int, maps: Maps, queries: Queries, paths: PathArrays) -> None:
    """Plan all scenes, on several threads."""
    for b in prange(batch):
        plan_one(b, maps, queries, paths)
