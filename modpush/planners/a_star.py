"""A* from cell to cell, with costs if wanted."""

from typing import Literal

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray
from torch import Tensor

from modpush._batching import run_batch
from modpush.planners.base import Paths
from modpush.planners.kernels.heap import heap_pop, heap_set
from modpush.planners.kernels.scene_maps import (
    GridPlanner,
    Maps,
    PathArrays,
    place_ends,
    refresh_map,
    write_path,
)
from modpush.planners.kernels.visibility import FRACTION_BITS, ONE, SE

_DX = np.array([1, -1, 0, 0, 1, -1, 1, -1], dtype=np.int64)
_DY = np.array([0, 0, 1, -1, 1, 1, -1, -1], dtype=np.int64)


@njit(cache=True, nogil=True)
def _remaining(dx: int, dy: int, neighbours: int) -> float:
    """Length of the shortest way over (dx, dy) cells where nothing is blocked."""
    dx, dy = abs(dx), abs(dy)
    if neighbours == 4:
        return float(dx + dy)
    return max(dx, dy) + (np.sqrt(2.0) - 1.0) * min(dx, dy)


@njit(cache=True, nogil=True)
def search_cells(
    codes: NDArray,
    weight: NDArray,
    cheapest: float,
    start: int,
    goal: int,
    neighbours: int,
    cost: NDArray,
    parent: NDArray,
) -> bool:
    """A* over cells numbered row by row.

    A step costs its length times the mean weight of the two cells. A diagonal one needs both cells
    beside it free.

    Args:
        codes: `[H + 1, W + 1]` uint8 from `visibility.vertex_codes`.
        weight: `[H, W]` float32, positive; `[1, 1]` stands for the same everywhere.
        cheapest: Least weight there is.
        start: Cell to start from, free.
        goal: Cell to reach, free.
        neighbours: 4 or 8.
        cost: `[H * W]` float64, overwritten with the least cost to the cells that were expanded.
        parent: `[H * W]` int32, overwritten with the cell before; -1 where none.

    Returns:
        Whether the goal was reached.
    """
    width = codes.shape[1] - 1
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
                rest = cheapest * _remaining(ti - goal_i, tj - goal_j, neighbours)
                size = heap_set(order, key, slot, size, target, cost[target] + rest)
    return False


@njit(cache=True, nogil=True)
def _plan_one(
    b: int,
    maps: Maps,
    cells: NDArray,
    weight: NDArray,
    start: NDArray,
    goal: NDArray,
    neighbours: int,
    scale: float,
    paths: PathArrays,
) -> None:
    x, y = np.empty(2, dtype=np.int64), np.empty(2, dtype=np.int64)
    refresh_map(maps, b, cells[b])
    if not place_ends(maps, b, start[b], goal[b], x, y, paths):
        return
    height, width = cells.shape[1:]
    first = (y[0] >> FRACTION_BITS) * width + (x[0] >> FRACTION_BITS)
    last = (y[1] >> FRACTION_BITS) * width + (x[1] >> FRACTION_BITS)
    cost = np.empty(height * width)
    parent = np.empty(height * width, dtype=np.int32)
    scene_weight = weight[0]
    if weight.shape[0] > 1:
        scene_weight = weight[b]
    cheapest = scene_weight.min()
    codes = maps.codes[b]
    if not search_cells(codes, scene_weight, cheapest, first, last, neighbours, cost, parent):
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
    write_path(paths, b, start[b], goal[b], path_x[at:], path_y[at:], scale)


@njit(cache=True, nogil=True, parallel=True)
def _plan_many(
    batch: int,
    maps: Maps,
    cells: NDArray,
    weight: NDArray,
    start: NDArray,
    goal: NDArray,
    neighbours: int,
    scale: float,
    paths: PathArrays,
) -> None:
    for b in prange(batch):
        _plan_one(b, maps, cells, weight, start, goal, neighbours, scale, paths)


class AStar(GridPlanner):
    """A* over cells with 4 or 8 neighbours, never cutting a blocked cell's corner.

    Optimal among the paths from cell centre to cell centre, which the first and the last leg join
    to ends that are not at one. `Paths.length` is the path's length, also where a weight was
    minimised instead.

    Args:
        cell_size: Metres a pixel; lengths are given in pixels times this.
        neighbours: 4 or 8.

    Raises:
        ValueError: If `neighbours` is neither.

    Source: Hart, Nilsson, Raphael, "A Formal Basis for the Heuristic Determination of Minimum Cost
        Paths" (1968).
    """

    def __init__(self, cell_size: float = 1.0, neighbours: Literal[4, 8] = 8) -> None:
        super().__init__(cell_size)
        if neighbours not in (4, 8):
            raise ValueError(f"AStar: neighbours must be 4 or 8, got {neighbours!r}.")
        self.neighbours = neighbours
        self._weight = np.ones((1, 1, 1), dtype=np.float32)

    def plan_weighted(
        self, occupancy: Tensor, weight: Tensor, start: Tensor, goal: Tensor
    ) -> Paths:
        """As `plan`, least in weight: a step costs its length times its two cells' mean weight.

        Args:
            occupancy: `[B, H, W]` bool, True where blocked.
            weight: `[B, H, W]` float32, positive; read where free.
            start: `[B, 2]` float (u, v) [px].
            goal: `[B, 2]` float (u, v) [px].

        Raises:
            ValueError: If the weight is not positive, or not of the occupancy's shape; and as
                `plan`.
        """
        if weight.shape != occupancy.shape:
            raise ValueError(
                f"AStar: weight must have the occupancy's shape {list(occupancy.shape)}, got "
                f"{list(weight.shape)}."
            )
        if not (weight > 0).all():
            raise ValueError(f"AStar: weight must be > 0, its least is {weight.min().item()}.")
        kept, self._weight = self._weight, weight.detach().float().cpu().contiguous().numpy()
        try:
            return self.plan(occupancy, start, goal)
        finally:
            self._weight = kept

    def _run(
        self, maps: Maps, cells: NDArray, start: NDArray, goal: NDArray, paths: PathArrays
    ) -> None:
        run_batch(
            _plan_one,
            _plan_many,
            len(cells),
            maps,
            cells,
            self._weight,
            start,
            goal,
            self.neighbours,
            self.cell_size,
            paths,
        )
