"""Lazy Theta*, over convex corners or over the whole grid, for a batch of scenes."""

import numpy as np
from numba import prange
from numpy.typing import NDArray

from modpush._kernels import BatchKernel, njit
from modpush.planners.kernels.maps import (
    MAX_CORNERS,
    Maps,
    PathArrays,
    Queries,
    corner_count,
    place_ends,
    refresh_map,
    write_path,
)
from modpush.planners.kernels.taut_search import taut_search
from modpush.planners.kernels.theta_search import solve_over_grid
from modpush.planners.kernels.visibility import line_of_sight

TOO_MANY_CORNERS = -1


@njit(nogil=True)
def _solve_over_corners(
    b: int, maps: Maps, queries: Queries, x: NDArray, y: NDArray, paths: PathArrays
) -> None:
    corners = maps.corner_counts[b]
    nodes = maps.corners[b, : corners + 2]
    for k in range(2):
        nodes[corners + k, 0], nodes[corners + k, 1] = x[k], y[k]
        nodes[corners + k, 2] = nodes[corners + k, 3] = 0
    cost = np.empty(corners + 2)
    parent = np.empty(corners + 2, dtype=np.int32)
    taut_search(maps.codes[b], nodes, corners, corners + 1, cost, parent)
    if parent[corners + 1] < 0:
        return
    node, count = corners + 1, 1
    while node != corners:
        node = parent[node]
        count += 1
    path_x, path_y = np.empty(count, dtype=np.int64), np.empty(count, dtype=np.int64)
    node = corners + 1
    for k in range(count - 1, -1, -1):
        path_x[k], path_y[k] = nodes[node, 0], nodes[node, 1]
        node = parent[node]
    write_path(paths, b, queries, path_x, path_y)


@njit(nogil=True)
def _place(b: int, maps: Maps, queries: Queries, x: NDArray, y: NDArray, paths: PathArrays) -> bool:
    """Store scene b's map and ends, and write its path where it is straight; False if that is all."""
    refresh_map(maps, b, queries.cells[b])
    if not place_ends(maps, b, queries, x, y, paths):
        return False
    if line_of_sight(maps.codes[b], x[0], y[0], x[1], y[1]):
        write_path(paths, b, queries, x, y)
        return False
    return True


@BatchKernel
def plan_over_corners(batch: int, maps: Maps, queries: Queries, paths: PathArrays) -> None:
    """Plan all scenes; `paths.sizes` is `TOO_MANY_CORNERS` where a map has more than `MAX_CORNERS`."""
    for b in prange(batch):
        x, y = np.empty(2, dtype=np.int64), np.empty(2, dtype=np.int64)
        if _place(b, maps, queries, x, y, paths):
            if corner_count(maps, b) > MAX_CORNERS:
                paths.sizes[b] = TOO_MANY_CORNERS
            else:
                _solve_over_corners(b, maps, queries, x, y, paths)


# The scenes are a batch of their own, so that this search is compiled only where it is needed.
@BatchKernel
def plan_over_grid(
    batch: int, scenes: NDArray, maps: Maps, queries: Queries, paths: PathArrays
) -> None:
    """Plan the scenes of an int64 `[batch]` array."""
    for k in prange(batch):
        b = scenes[k]
        x, y = np.empty(2, dtype=np.int64), np.empty(2, dtype=np.int64)
        if _place(b, maps, queries, x, y, paths):
            solve_over_grid(b, maps, queries, x, y, paths)


def plan_what_is_left(maps: Maps, queries: Queries, paths: PathArrays) -> None:
    """Plan the scenes over the grid that have too many corners to be planned over these."""
    scenes = np.flatnonzero(paths.sizes == TOO_MANY_CORNERS)
    if scenes.size:
        plan_over_grid(scenes.size, scenes, maps, queries, paths)
