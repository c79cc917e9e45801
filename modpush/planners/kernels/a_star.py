"""A* from cell to cell, for a batch of scenes."""

from typing import NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from modpush._kernels import BatchKernel, njit
from modpush.planners.kernels.heap import heap_pop, heap_set
from modpush.planners.kernels.maps import (
    Maps,
    PathArrays,
    Queries,
    place_ends,
    refresh_map,
    write_path,
)
from modpush.planners.kernels.visibility import FRACTION_BITS, ONE, SE

_DX = np.array([1, -1, 0, 0, 1, -1, 1, -1], dtype=np.int64)
_DY = np.array([0, 0, 1, -1, 1, 1, -1, -1], dtype=np.int64)


class Steps(NamedTuple):
    """Steps between cells and their costs."""

    weight: NDArray  # `[H, W]` float32, positive; `[1, 1]` stands for the same everywhere
    cheapest: float  # The least weight
    neighbours: int  # 4 or 8


@njit(nogil=True)
def _remaining(dx: int, dy: int, neighbours: int) -> float:
    """Length of the shortest path over (dx, dy) free cells."""
    dx, dy = abs(dx), abs(dy)
    if neighbours == 4:
        return float(dx + dy)
    return max(dx, dy) + (np.sqrt(2.0) - 1.0) * min(dx, dy)


@njit(nogil=True)
def search_cells(
    codes: NDArray, steps: Steps, start: int, goal: int, cost: NDArray, parent: NDArray
) -> bool:
    """A* over cells numbered row by row; True if the goal was reached.

    A step costs its length times the mean weight of the two cells. A diagonal one needs both cells
    beside it free. `codes` are `visibility.vertex_codes`. `cost` and `parent` `[H * W]` are overwritten
    with the least cost to the cells that were expanded and with the cell before, -1 where none.
    """
    width = codes.shape[1] - 1
    weight, neighbours = steps.weight, steps.neighbours
    weighted = weight.size > 1
    closed = np.zeros(cost.size, dtype=np.uint8)
    key, slot = np.empty(cost.size), np.full(cost.size, -1, dtype=np.int32)
    order = np.empty(cost.size, dtype=np.int32)
    cost[:] = np.inf
    parent[:] = -1
    goal_i, goal_j = goal % width, goal // width
    cost[start] = 0.0
    size = heap_set(order, key, slot, 0, start, 0.0)
    while size > 0:
        cell = heap_pop(order, key, slot, size)
        size -= 1
        closed[cell] = 1
        if cell == goal:
            return True
        i, j = cell % width, cell // width
        for k in range(neighbours):
            ti, tj = i + _DX[k], j + _DY[k]
            if ti < 0 or tj < 0 or ti >= width or tj >= codes.shape[0] - 1 or codes[tj, ti] & SE:
                continue
            if k >= 4 and (codes[j, ti] & SE or codes[tj, i] & SE):
                continue
            target = tj * width + ti
            if closed[target]:
                continue
            step = 1.0 if k < 4 else np.sqrt(2.0)
            step *= (0.5 * (weight[j, i] + weight[tj, ti])) if weighted else weight[0, 0]
            if cost[cell] + step < cost[target]:
                cost[target] = cost[cell] + step
                parent[target] = cell
                rest = steps.cheapest * _remaining(ti - goal_i, tj - goal_j, neighbours)
                size = heap_set(order, key, slot, size, target, cost[target] + rest)
    return False


@njit(nogil=True)
def plan_one(
    b: int, maps: Maps, queries: Queries, paths: PathArrays, weight: NDArray, neighbours: int
) -> None:
    """Plan scene b; `weight` is `[B, H, W]` float32, or `[1, 1, 1]` for the same everywhere."""
    x, y = np.empty(2, dtype=np.int64), np.empty(2, dtype=np.int64)
    refresh_map(maps, b, queries.cells[b])
    if not place_ends(maps, b, queries, x, y, paths):
        return
    height, width = queries.cells.shape[1:]
    first = (y[0] >> FRACTION_BITS) * width + (x[0] >> FRACTION_BITS)
    last = (y[1] >> FRACTION_BITS) * width + (x[1] >> FRACTION_BITS)
    cost = np.empty(height * width)
    parent = np.empty(height * width, dtype=np.int32)
    scene_weight = weight[0]
    if weight.shape[0] > 1:
        scene_weight = weight[b]
    steps = Steps(scene_weight, scene_weight.min(), neighbours)
    if not search_cells(maps.codes[b], steps, first, last, cost, parent):
        return
    # Backwards, keeping only the cells at which the path turns.
    path_x = np.empty(height * width + 2, dtype=np.int64)
    path_y = np.empty(height * width + 2, dtype=np.int64)
    at, cell, heading = path_x.size, last, 0
    while cell != first:
        before = parent[cell]
        if before - cell != heading:
            at -= 1
            path_x[at] = ((cell % width) << FRACTION_BITS) + ONE // 2
            path_y[at] = ((cell // width) << FRACTION_BITS) + ONE // 2
            heading = before - cell
        cell = before
    at -= 1
    path_x[at], path_y[at] = x[0], y[0]
    if at == path_x.size - 1:  # start and goal share a cell
        at -= 1
        path_x[at], path_y[at] = x[0], y[0]
    path_x[path_x.size - 1], path_y[path_x.size - 1] = x[1], y[1]
    write_path(paths, b, queries, path_x[at:], path_y[at:])


@BatchKernel
def plan_all(
    batch: int, maps: Maps, queries: Queries, paths: PathArrays, weight: NDArray, neighbours: int
) -> None:
    """Plan all scenes; arguments as in `plan_one`."""
    for b in prange(batch):
        plan_one(b, maps, queries, paths, weight, neighbours)
