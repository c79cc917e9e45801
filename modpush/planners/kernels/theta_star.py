"""Theta* and Lazy Theta* over the whole grid, for a batch of scenes."""

import numpy as np
from numba import prange
from numpy.typing import NDArray

from modpush._kernels import njit
from modpush.planners.kernels.maps import Maps, refresh_map
from modpush.planners.kernels.paths import PathArrays, Queries, place_ends, write_path
from modpush.planners.kernels.theta_search import (
    Query,
    SearchTree,
    node_position,
    node_shift,
    theta_search,
)

__all__ = ["plan_few", "plan_many", "solve_over_grid"]


@njit(nogil=True)
def solve_over_grid(
    b: int,
    maps: Maps,
    queries: Queries,
    x: NDArray,
    y: NDArray,
    lazy: bool,
    paths: PathArrays,
) -> None:
    """Plan scene b by `theta_search`; its map is known and its ends are placed."""
    codes = maps.codes[b]
    shift = node_shift(codes.shape[1] - 1)
    size = (codes.shape[0] << shift) + 2
    query = Query(codes, x, y, shift)
    tree = SearchTree(
        np.empty(size),
        np.empty(size),
        np.empty(size, dtype=np.int32),
        np.empty(size, dtype=np.uint8),
        np.empty(size),
        np.empty(size, dtype=np.int32),
        np.empty(size, dtype=np.int32),
    )
    if not theta_search(query, tree, lazy):
        return
    node, count = size - 1, 1
    while node != size - 2:
        node = tree.parent[node]
        count += 1
    path_x, path_y = np.empty(count, dtype=np.int64), np.empty(count, dtype=np.int64)
    node = size - 1
    for k in range(count - 1, -1, -1):
        path_x[k], path_y[k] = node_position(query, node)
        node = tree.parent[node]
    write_path(paths, b, queries, path_x, path_y)


@njit(nogil=True)
def plan_one(b: int, maps: Maps, queries: Queries, paths: PathArrays) -> None:
    """Plan scene b by Theta*."""
    x, y = np.empty(2, dtype=np.int64), np.empty(2, dtype=np.int64)
    refresh_map(maps, b, queries.cells[b])
    if place_ends(maps, b, queries, x, y, paths):
        solve_over_grid(b, maps, queries, x, y, False, paths)


@njit(nogil=True)
def plan_few(batch: int, maps: Maps, queries: Queries, paths: PathArrays) -> None:
    """Plan all scenes by Theta*, one after the other."""
    for b in range(batch):
        plan_one(b, maps, queries, paths)


@njit(nogil=True, parallel=True)
def plan_many(batch: int, maps: Maps, queries: Queries, paths: PathArrays) -> None:
    """Plan all scenes by Theta*, on several threads."""
    for b in prange(batch):
        plan_one(b, maps, queries, paths)
