"""Exact shortest paths on a grid of blocked cells: a search over corners with lazy lines of sight.

A shortest path around blocked cells is a string pulled taut: it bends only at convex corners, and
at each of them around the blocked cell. So the corners are all the nodes that are needed, and the
successors of a corner are only those in the narrow wedge that keeps the string taut. As in Lazy
Theta*, an edge is queued unchecked, and its line of sight is tested once, when it is taken from the
queue: it is then the shortest edge that is left, and final if it is free.

Source: the lazy rule from Nash, Koenig, Tovey, "Lazy Theta*" (AAAI 2010); taut paths from Oh and
Leong, "Edge N-Level Sparse Visibility Graphs" (SoCS 2017), and Lozano-Pérez and Wesley (CACM 1979).
"""

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
from modpush.planners.kernels.theta_search import solve_over_grid
from modpush.planners.kernels.visibility import ONE, line_of_sight

_FIRST_EDGES = 2048


@njit(nogil=True)
def length_of(dx: int, dy: int) -> float:
    """Length in cells of a vector in fixed point."""
    fx, fy = float(dx), float(dy)
    return np.sqrt(fx * fx + fy * fy) / ONE


@njit(nogil=True)
def touches(dx: int, dy: int, bx: int, by: int) -> bool:
    """True if a line in direction (dx, dy) through a corner stays out of its blocked cell in (bx, by)."""
    return (dx * bx) * (dy * by) <= 0


@njit(nogil=True)
def stays_taut(ax: int, ay: int, cx: int, cy: int, bx: int, by: int) -> bool:
    """True if a string that arrives along (ax, ay) and leaves along (cx, cy) bends around a cell.

    It touches the cell on arrival. (bx, by) is the direction of the blocked cell from the corner, -1 or
    1 each. It is False only if the string would slacken or run through the cell.
    """
    if not touches(cx, cy, bx, by) or ax * cx + ay * cy < 0:
        return False
    turn = ax * cy - ay * cx
    if ax * by - ay * bx > 0:
        return turn >= 0
    return turn <= 0


@njit(nogil=True)
def _push_edge(
    key: NDArray, ends: NDArray, size: int, value: float, a: int, b: int
) -> tuple[NDArray, NDArray]:
    """Insert the edge a-b into the heap of edges, which grows as it must."""
    if size == key.shape[0]:
        bigger_key = np.empty(2 * size, dtype=key.dtype)
        bigger_ends = np.empty((2 * size, 2), dtype=ends.dtype)
        bigger_key[:size] = key
        bigger_ends[:size] = ends
        key, ends = bigger_key, bigger_ends
    at = size
    while at > 0:
        above = (at - 1) >> 1
        if key[above] <= value:
            break
        key[at] = key[above]
        ends[at, 0], ends[at, 1] = ends[above, 0], ends[above, 1]
        at = above
    key[at] = value
    ends[at, 0], ends[at, 1] = a, b
    return key, ends


@njit(nogil=True)
def _drop_first_edge(key: NDArray, ends: NDArray, size: int) -> None:
    """Take the first of `size` edges out of the heap."""
    last = size - 1
    value, a, b = key[last], ends[last, 0], ends[last, 1]
    at = 0
    while True:
        below = 2 * at + 1
        if below >= last:
            break
        if below + 1 < last and key[below + 1] < key[below]:
            below += 1
        if key[below] >= value:
            break
        key[at] = key[below]
        ends[at, 0], ends[at, 1] = ends[below, 0], ends[below, 1]
        at = below
    key[at] = value
    ends[at, 0], ends[at, 1] = a, b


@njit(nogil=True)
def taut_search(
    codes: NDArray,
    nodes: NDArray,
    root: int,
    target: int,
    cost: NDArray,
    parent: NDArray,
) -> None:
    """Exact shortest paths from one node over the corners.

    `nodes` `[N, 4]` are rows of `visibility.convex_corners`, and the root and the target with (0, 0) for
    the blocked cell's direction. The search stops when the target's path is known, or, with the target
    -1, when all are. `cost` `[N]` float64 is overwritten with the lengths [cells], inf where none is
    known, and `parent` `[N]` int32 with the node before, the root's itself, -1 where no path is known.
    """
    count = nodes.shape[0]
    heuristic = np.zeros(count)
    cost[:] = np.inf
    parent[:] = -1
    if target >= 0:
        for v in range(count):
            dx, dy = nodes[target, 0] - nodes[v, 0], nodes[target, 1] - nodes[v, 1]
            heuristic[v] = length_of(dx, dy)
    key = np.empty(_FIRST_EDGES)
    ends = np.empty((_FIRST_EDGES, 2), dtype=np.int32)
    size = np.int64(0)  # a literal 0 would compile each function that takes it once more
    node, came_from = root, root
    cost[root] = 0.0
    while True:
        parent[node] = came_from
        if node == target:
            return
        x, y, bx, by = nodes[node, 0], nodes[node, 1], nodes[node, 2], nodes[node, 3]
        ax, ay = x - nodes[came_from, 0], y - nodes[came_from, 1]
        for v in range(count):
            dx, dy = nodes[v, 0] - x, nodes[v, 1] - y
            if not touches(dx, dy, nodes[v, 2], nodes[v, 3]) or parent[v] >= 0:
                continue
            if node != root and not stays_taut(ax, ay, dx, dy, bx, by):
                continue
            value = cost[node] + length_of(dx, dy) + heuristic[v]
            key, ends = _push_edge(key, ends, size, value, node, v)
            size += 1
        found = False
        while size > 0 and not found:
            came_from, node = ends[0, 0], ends[0, 1]
            _drop_first_edge(key, ends, size)
            size -= 1
            found = parent[node] < 0 and line_of_sight(
                codes, nodes[came_from, 0], nodes[came_from, 1], nodes[node, 0], nodes[node, 1]
            )
        if not found:
            return
        dx, dy = nodes[node, 0] - nodes[came_from, 0], nodes[node, 1] - nodes[came_from, 1]
        cost[node] = cost[came_from] + length_of(dx, dy)


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
