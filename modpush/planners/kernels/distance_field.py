"""Fields of shortest paths to a goal, and paths read from them, for a batch of scenes."""

from typing import NamedTuple

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
from modpush.planners.kernels.taut_search import (
    TOO_MANY_CORNERS,
    length_of,
    stays_taut,
    taut_search,
    touches,
)
from modpush.planners.kernels.visibility import line_of_sight


class Fields(NamedTuple):
    """Shortest paths from all corners to the goal, for each scene."""

    # `[B, 2]` int64, the goal in the vertex frame, fixed point; -1 if nothing is built
    goal: NDArray
    # `[B, MAX_CORNERS + 1]` float64, path length from each corner to the goal [px], goal last
    cost: NDArray
    parent: NDArray  # `[B, MAX_CORNERS + 1]` int32, the next corner on it
    builds: NDArray  # `[B]` int64, how often a field was built


def empty_fields(batch: int) -> Fields:
    """Empty fields of a batch."""
    return Fields(
        goal=np.full((batch, 2), -1, dtype=np.int64),
        cost=np.empty((batch, MAX_CORNERS + 1)),
        parent=np.empty((batch, MAX_CORNERS + 1), dtype=np.int32),
        builds=np.zeros(batch, dtype=np.int64),
    )


@njit(nogil=True)
def _build(b: int, maps: Maps, fields: Fields, x: int, y: int, count: int) -> None:
    nodes = maps.corners[b, : count + 1]
    nodes[count, 0], nodes[count, 1] = x, y
    nodes[count, 2] = nodes[count, 3] = 0
    cost, parent = fields.cost[b, : count + 1], fields.parent[b, : count + 1]
    everything = np.int64(-1)  # a literal would compile the search a second time
    taut_search(maps.codes[b], nodes, count, everything, cost, parent)
    fields.goal[b, 0], fields.goal[b, 1] = x, y
    fields.builds[b] += 1


@njit(nogil=True)
def _first_corner(b: int, maps: Maps, fields: Fields, x: int, y: int, count: int) -> int:
    """The corner that the shortest path from (x, y) bends at first, -1 if there is no path."""
    nodes, codes = maps.corners[b, : count + 1], maps.codes[b]
    parent = fields.parent[b]
    length = np.full(count, np.inf)
    for v in range(count):
        after = parent[v]
        if after < 0:
            continue
        dx, dy = nodes[v, 0] - x, nodes[v, 1] - y
        bx, by = nodes[v, 2], nodes[v, 3]
        ox, oy = nodes[after, 0] - nodes[v, 0], nodes[after, 1] - nodes[v, 1]
        if touches(dx, dy, bx, by) and stays_taut(dx, dy, ox, oy, bx, by):
            length[v] = length_of(dx, dy) + fields.cost[b, v]
    while True:  # by length of the whole path: the first that is seen is the shortest
        best = -1
        for v in range(count):
            if length[v] < np.inf and (best < 0 or length[v] < length[best]):
                best = v
        if best < 0 or line_of_sight(codes, x, y, nodes[best, 0], nodes[best, 1]):
            return best
        length[best] = np.inf


@njit(nogil=True)
def plan_one(b: int, maps: Maps, queries: Queries, paths: PathArrays, fields: Fields) -> None:
    """Plan scene b, and build its field for a new map or goal."""
    x, y = np.empty(2, dtype=np.int64), np.empty(2, dtype=np.int64)
    if refresh_map(maps, b, queries.cells[b]):
        fields.goal[b, 0] = -1
    if not place_ends(maps, b, queries, x, y, paths):
        return
    if line_of_sight(maps.codes[b], x[0], y[0], x[1], y[1]):
        write_path(paths, b, queries, x, y)
        return
    count = corner_count(maps, b)
    if count > MAX_CORNERS:
        paths.sizes[b] = TOO_MANY_CORNERS
        return
    if fields.goal[b, 0] != x[1] or fields.goal[b, 1] != y[1]:
        _build(b, maps, fields, x[1], y[1], count)
    first = _first_corner(b, maps, fields, x[0], y[0], count)
    if first < 0:
        return
    node, steps = first, 2
    while node != count:
        node = fields.parent[b, node]
        steps += 1
    path_x, path_y = np.empty(steps, dtype=np.int64), np.empty(steps, dtype=np.int64)
    path_x[0], path_y[0] = x[0], y[0]
    node = first
    for k in range(1, steps):
        path_x[k], path_y[k] = maps.corners[b, node, 0], maps.corners[b, node, 1]
        node = fields.parent[b, node]
    write_path(paths, b, queries, path_x, path_y)


@BatchKernel
def plan_over_fields(
    batch: int, maps: Maps, queries: Queries, paths: PathArrays, fields: Fields
) -> None:
    """Plan all scenes; `paths.sizes` is `TOO_MANY_CORNERS` where a map has more than `MAX_CORNERS`."""
    for b in prange(batch):
        plan_one(b, maps, queries, paths, fields)
