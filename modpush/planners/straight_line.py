"""The straight line: the planner to measure others against, and to test with."""

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from modpush._batching import run_batch
from modpush.planners.kernels.scene_maps import (
    GridPlanner,
    Maps,
    PathArrays,
    place_ends,
    refresh_map,
    write_path,
)
from modpush.planners.kernels.visibility import line_of_sight


@njit(cache=True, nogil=True)
def _plan_one(
    b: int,
    maps: Maps,
    cells: NDArray,
    start: NDArray,
    goal: NDArray,
    scale: float,
    paths: PathArrays,
) -> None:
    x, y = np.empty(2, dtype=np.int64), np.empty(2, dtype=np.int64)
    refresh_map(maps, b, cells[b])
    if not place_ends(maps, b, start[b], goal[b], x, y, paths):
        return
    if line_of_sight(maps.codes[b], x[0], y[0], x[1], y[1]):
        write_path(paths, b, start[b], goal[b], x, y, scale)


@njit(cache=True, nogil=True, parallel=True)
def _plan_many(
    batch: int,
    maps: Maps,
    cells: NDArray,
    start: NDArray,
    goal: NDArray,
    scale: float,
    paths: PathArrays,
) -> None:
    for b in prange(batch):
        _plan_one(b, maps, cells, start, goal, scale, paths)


class StraightLine(GridPlanner):
    """The straight line from start to goal, found only where no blocked cell is in the way.

    Args:
        cell_size: Metres a pixel; lengths are given in pixels times this.
    """

    def _run(
        self, maps: Maps, cells: NDArray, start: NDArray, goal: NDArray, paths: PathArrays
    ) -> None:
        run_batch(
            _plan_one, _plan_many, len(cells), maps, cells, start, goal, self.cell_size, paths
        )
