"""What the kernels keep about each scene's map, and how they hand out paths."""

from abc import abstractmethod
from typing import Any, NamedTuple

import numpy as np
import torch
from numba import njit
from numpy.typing import NDArray
from torch import Tensor

from modpush.planners.base import Paths, Planner
from modpush.planners.kernels.visibility import ONE, convex_corners, place, vertex_codes

# Searches over corners take time quadratic in their number. A map of ten inflated bars has 440;
# past this number the map is noise, and planners turn to searches over the grid.
MAX_CORNERS = 2048
_UNKNOWN = -1


class Maps(NamedTuple):
    """The last map seen in each row of the batch, with what follows from it.

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


class PathArrays(NamedTuple):
    """Where kernels write paths: fields of `Paths`; `sizes` is its `count`, also where too big."""

    waypoints: NDArray
    sizes: NDArray
    length: NDArray
    found: NDArray
    start_moved: NDArray
    goal_moved: NDArray


def empty_maps(batch: int, height: int, width: int) -> Maps:
    """Room for the maps of a batch, none known yet."""
    return Maps(
        cells=np.full((batch, height, width), 255, dtype=np.uint8),
        codes=np.zeros((batch, height + 1, width + 1), dtype=np.uint8),
        corners=np.zeros((batch, MAX_CORNERS + 2, 4), dtype=np.int64),
        corner_counts=np.full(batch, _UNKNOWN, dtype=np.int64),
    )


def empty_paths(batch: int, capacity: int) -> PathArrays:
    """Room for a batch of paths of up to `capacity` waypoints."""
    return PathArrays(
        waypoints=np.empty((batch, capacity, 2), dtype=np.float32),
        sizes=np.zeros(batch, dtype=np.int64),
        length=np.empty(batch, dtype=np.float32),
        found=np.zeros(batch, dtype=np.bool_),
        start_moved=np.zeros(batch, dtype=np.bool_),
        goal_moved=np.zeros(batch, dtype=np.bool_),
    )


def to_paths(arrays: PathArrays) -> Paths:
    """Wrap what a kernel wrote; the waypoints are cut to the longest path's."""
    longest = max(2, int(arrays.sizes.max(initial=0)))
    return Paths(
        waypoints=torch.from_numpy(arrays.waypoints)[:, :longest],
        count=torch.from_numpy(arrays.sizes),
        length=torch.from_numpy(arrays.length),
        found=torch.from_numpy(arrays.found),
        start_moved=torch.from_numpy(arrays.start_moved),
        goal_moved=torch.from_numpy(arrays.goal_moved),
    )


def as_cells(occupancy: Tensor) -> NDArray[Any]:
    """A bool tensor as uint8 cells, without a copy."""
    return occupancy.view(torch.uint8).numpy()


@njit(cache=True, nogil=True)
def refresh_map(maps: Maps, b: int, cells: NDArray) -> bool:
    """Take note of scene b's map; returns whether it differs from the last one."""
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


@njit(cache=True, nogil=True)
def corner_count(maps: Maps, b: int) -> int:
    """Number of scene b's convex corners, listed if they are not yet."""
    if maps.corner_counts[b] < 0:
        maps.corner_counts[b] = convex_corners(maps.codes[b], maps.corners[b, :MAX_CORNERS])
    return maps.corner_counts[b]


@njit(cache=True, nogil=True)
def place_ends(
    maps: Maps, b: int, start: NDArray, goal: NDArray, x: NDArray, y: NDArray, paths: PathArrays
) -> bool:
    """Put a query's ends into free space and preset the result to "not found".

    Args:
        maps: The maps.
        b: Scene.
        start: `[2]` (u, v) [px].
        goal: `[2]` (u, v) [px].
        x: `[2]` int64, overwritten with start's and goal's x in the vertex frame, fixed point.
        y: `[2]` int64, the same for y.
        paths: Where the result goes.

    Returns:
        Whether there is any free cell.
    """
    x[0], y[0], paths.start_moved[b] = place(maps.codes[b], start[0], start[1])
    x[1], y[1], paths.goal_moved[b] = place(maps.codes[b], goal[0], goal[1])
    paths.found[b] = False
    paths.sizes[b] = 0
    paths.length[b] = np.inf
    paths.waypoints[b, :, 0] = start[0]
    paths.waypoints[b, :, 1] = start[1]
    return x[0] >= 0


@njit(cache=True, nogil=True)
def _add_waypoint(paths: PathArrays, b: int, u: float, v: float) -> None:
    at = paths.sizes[b]
    if at < paths.waypoints.shape[1]:
        paths.waypoints[b, at, 0] = u
        paths.waypoints[b, at, 1] = v
    paths.sizes[b] = at + 1


@njit(cache=True, nogil=True)
def write_path(
    paths: PathArrays, b: int, start: NDArray, goal: NDArray, x: NDArray, y: NDArray, scale: float
) -> None:
    """Write scene b's path.

    Args:
        paths: Where to.
        b: Scene.
        start: `[2]` (u, v) [px] as asked for.
        goal: `[2]` (u, v) [px] as asked for.
        x: `[N]` int64, N >= 2, the path's x in the vertex frame, fixed point, ends as placed.
        y: `[N]` int64, its y.
        scale: Length of a pixel.
    """
    count = x.shape[0]
    paths.found[b] = True
    paths.sizes[b] = 0
    _add_waypoint(paths, b, start[0], start[1])
    u, v = float(start[0]), float(start[1])
    length = 0.0
    for k in range(0 if paths.start_moved[b] else 1, count + 1):
        if k == count or (k == count - 1 and not paths.goal_moved[b]):
            next_u, next_v = float(goal[0]), float(goal[1])
        else:
            next_u, next_v = x[k] / ONE - 0.5, y[k] / ONE - 0.5
        _add_waypoint(paths, b, next_u, next_v)
        length += np.sqrt((next_u - u) ** 2 + (next_v - v) ** 2)
        u, v = next_u, next_v
        if k == count - 1 and not paths.goal_moved[b]:
            break
    paths.length[b] = length * scale
    for k in range(paths.sizes[b], paths.waypoints.shape[1]):
        paths.waypoints[b, k, 0] = goal[0]
        paths.waypoints[b, k, 1] = goal[1]


class GridPlanner(Planner):
    """Implement `_run`: a planner whose work is done by kernels, with memory of the last maps.

    The memory only saves work: it is checked against the map of every call, so a planner may be
    shared, copied, pickled, and asked about any scenes in any order.

    Args:
        cell_size: Metres a pixel; lengths are given in pixels times this.
    """

    def __init__(self, cell_size: float = 1.0) -> None:
        super().__init__(cell_size)
        self._maps: Maps | None = None
        self._capacity = 64  # waypoints; grows with the first path that needs more

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_maps": None}

    def _plan(self, occupancy: Tensor, start: Tensor, goal: Tensor) -> Paths:
        if self._maps is None or self._maps.cells.shape != occupancy.shape:
            self._maps = empty_maps(*occupancy.shape)
        cells = as_cells(occupancy)
        while True:
            paths = empty_paths(len(cells), self._capacity)
            self._run(self._maps, cells, start.numpy(), goal.numpy(), paths)
            needed = int(paths.sizes.max(initial=0))
            if needed <= self._capacity:
                return to_paths(paths)
            self._capacity = 2 * needed

    @abstractmethod
    def _run(
        self, maps: Maps, cells: NDArray, start: NDArray, goal: NDArray, paths: PathArrays
    ) -> None:
        """Write a path for each scene.

        Args:
            maps: Memory of the last maps, `[B, ...]`.
            cells: `[B, H, W]` uint8, 1 where blocked.
            start: `[B, 2]` float32 [px].
            goal: `[B, 2]` float32 [px].
            paths: Where to write.
        """
