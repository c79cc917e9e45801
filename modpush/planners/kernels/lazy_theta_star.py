"""Lazy Theta*, over convex corners or over the whole grid, for a batch of scenes."""

import numpy as np
from numba import prange
from numpy.typing import NDArray

from modpush._batching import BatchKernel
from modpush._kernels import njit
from modpush.planners.kernels.maps import MAX_CORNERS, Maps, corner_count, refresh_map
from modpush.planners.kernels.paths import PathArrays, Queries, place_ends, write_path
from modpush.planners.kernels.taut_search import taut_search
from modpush.planners.kernels.theta_search import solve_over_grid
from modpush.planners.kernels.visibility import line_of_sight

__all__ = ["plan_all", "solve_scene"]


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
def solve_scene(
    b: int,
    maps: Maps,
    queries: Queries,
    x: NDArray,
    y: NDArray,
    over_grid: bool,
    paths: PathArrays,
) -> None:
    """Plan scene b, with its map cached and its ends in free space."""
    if line_of_sight(maps.codes[b], x[0], y[0], x[1], y[1]):
        write_path(paths, b, queries, x, y)
    elif over_grid or corner_count(maps, b) > MAX_CORNERS:
        solve_over_grid(b, maps, queries, x, y, paths)
    else:
        _solve_over_corners(b, maps, queries, x, y, paths)


@njit(nogil=True)
def plan_one(b: int, maps: Maps, queries: Queries, paths: PathArrays, over_grid: bool) -> None:
    """Plan scene b."""
    x, y = np.empty(2, dtype=np.int64), np.empty(2, dtype=np.int64)
    refresh_map(maps, b, queries.cells[b])
    if place_ends(maps, b, queries, x, y, paths):
        solve_scene(b, maps, queries, x, y, over_grid, paths)


@BatchKernel
def plan_all(batch: int, maps: Maps, queries: Queries, paths: PathArrays, over_grid: bool) -> None:
    """Plan all scenes."""
    for b in prange(batch):
        plan_one(b, maps, queries, paths, over_grid)
