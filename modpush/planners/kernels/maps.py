"""Maps, queries and paths of a batch of scenes, which all searches share."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from modpush._kernels import njit
from modpush.planners.kernels.visibility import ONE, convex_corners, place, vertex_codes

# Searches over corners take time quadratic in their number. A map of ten inflated bars has 440;
# past this number the map is noise, and planners turn to searches over the grid.
MAX_CORNERS = 2048
_UNKNOWN = -1


class Maps(NamedTuple):
    """The last map of each scene of the batch, and quantities computed from it."""

    cells: NDArray  # `[B, H, W]` uint8, the map, 1 where blocked; 255 before the first
    codes: NDArray  # `[B, H + 1, W + 1]` uint8, see `visibility.vertex_codes`
    # `[B, MAX_CORNERS + 2, 4]` int64, see `visibility.convex_corners`; two rows more for a query's ends
    corners: NDArray
    corner_counts: NDArray  # `[B]` int64, number of corners, `_UNKNOWN` until asked for


def empty_maps(batch: int, height: int, width: int) -> Maps:
    """An empty cache for the maps of a batch."""
    return Maps(
        cells=np.full((batch, height, width), 255, dtype=np.uint8),
        codes=np.zeros((batch, height + 1, width + 1), dtype=np.uint8),
        corners=np.zeros((batch, MAX_CORNERS + 2, 4), dtype=np.int64),
        corner_counts=np.full(batch, _UNKNOWN, dtype=np.int64),
    )


@njit(nogil=True)
def refresh_map(maps: Maps, b: int, cells: NDArray) -> bool:
    """Store scene b's map; returns True if it differs from the last one."""
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


@njit(nogil=True)
def corner_count(maps: Maps, b: int) -> int:
    """Number of scene b's convex corners, which are listed if they have not been."""
    if maps.corner_counts[b] < 0:
        maps.corner_counts[b] = convex_corners(maps.codes[b], maps.corners[b, :MAX_CORNERS])
    return maps.corner_counts[b]


class Queries(NamedTuple):
    """Maps and ends of a batch of scenes."""

    cells: NDArray  # `[B, H, W]` uint8, 1 where blocked
    start: NDArray  # `[B, 2]` float32 (u, v) [px], finite
    goal: NDArray  # `[B, 2]` float32 (u, v) [px], finite
    scale: float  # Length of a pixel


class PathArrays(NamedTuple):
    """Arrays for a batch of paths; see `modpush.planners.Paths`."""

    waypoints: NDArray  # `[B, capacity, 2]` float32 (u, v) [px]
    # `[B]` int64, the paths' numbers of waypoints, also where they exceed the capacity
    sizes: NDArray
    length: NDArray  # `[B]` float32
    found: NDArray  # `[B]` bool
    start_moved: NDArray  # `[B]` bool
    goal_moved: NDArray  # `[B]` bool


def empty_paths(batch: int, capacity: int) -> PathArrays:
    """Arrays for a batch of paths of up to `capacity` waypoints."""
    return PathArrays(
        waypoints=np.empty((batch, capacity, 2), dtype=np.float32),
        sizes=np.zeros(batch, dtype=np.int64),
        length=np.empty(batch, dtype=np.float32),
        found=np.zeros(batch, dtype=np.bool_),
        start_moved=np.zeros(batch, dtype=np.bool_),
        goal_moved=np.zeros(batch, dtype=np.bool_),
    )


@njit(nogil=True)
def place_ends(
    maps: Maps, b: int, queries: Queries, x: NDArray, y: NDArray, paths: PathArrays
) -> bool:
    """Put a query's ends into free space, and preset the result to "not found".

    `x` and `y` `[2]` int64 are overwritten with start and goal in the vertex frame, fixed point. Returns
    True if there is something to search: a free cell, and a goal that is not the start.
    """
    start, goal = queries.start[b], queries.goal[b]
    x[0], y[0], paths.start_moved[b] = place(maps.codes[b], start[0], start[1])
    x[1], y[1], paths.goal_moved[b] = place(maps.codes[b], goal[0], goal[1])
    paths.found[b] = False
    paths.sizes[b] = 0
    paths.length[b] = np.inf
    paths.waypoints[b, :, 0] = start[0]
    paths.waypoints[b, :, 1] = start[1]
    if x[0] >= 0 and start[0] == goal[0] and start[1] == goal[1]:
        # Also where that is a blocked cell: it need not be left for a free one and entered again.
        paths.waypoints[b, :, 0], paths.waypoints[b, :, 1] = goal[0], goal[1]
        paths.found[b], paths.sizes[b], paths.length[b] = True, 2, 0.0
        return False
    return x[0] >= 0


@njit(nogil=True)
def _add_waypoint(paths: PathArrays, b: int, u: float, v: float) -> None:
    at = paths.sizes[b]
    if at < paths.waypoints.shape[1]:
        paths.waypoints[b, at, 0] = u
        paths.waypoints[b, at, 1] = v
    paths.sizes[b] = at + 1


@njit(nogil=True)
def write_path(paths: PathArrays, b: int, queries: Queries, x: NDArray, y: NDArray) -> None:
    """Write scene b's path, `x` and `y` `[N >= 2]` in the vertex frame, fixed point, ends as placed."""
    start, goal = queries.start[b], queries.goal[b]
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
    paths.length[b] = length * queries.scale
    for k in range(paths.sizes[b], paths.waypoints.shape[1]):
        paths.waypoints[b, k, 0] = goal[0]
        paths.waypoints[b, k, 1] = goal[1]
