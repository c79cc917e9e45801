"""The straight line, a baseline for comparisons and tests."""

import numpy as np
from numba import prange

from modpush._kernels import BatchKernel, njit
from modpush.planners.grid_planner import GridPlanner
from modpush.planners.kernels.maps import (
    Maps,
    PathArrays,
    Queries,
    place_ends,
    refresh_map,
    write_path,
)
from modpush.planners.kernels.visibility import line_of_sight


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


class StraightLine(GridPlanner):
    """The straight line from start to goal, found only where it crosses no blocked cell.

    Args:
        cell_size: Metres per pixel; lengths are given in pixels times this.
    """

    def _run(self, maps: Maps, queries: Queries, paths: PathArrays) -> None:
        plan_all(len(queries.cells), maps, queries, paths)
