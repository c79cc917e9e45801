"""Lazy Theta* over the whole grid: A* over the cells' corners, with any visible vertex as parent.

Source: Nash, Koenig, Tovey, "Lazy Theta*: Any-Angle Path Planning and Path Length Analysis in 3D" (AAAI
2010).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from modpush._kernels import njit
from modpush.planners.kernels.heap import heap_pop, heap_set
from modpush.planners.kernels.maps import Maps, PathArrays, Queries, write_path
from modpush.planners.kernels.visibility import FRACTION_BITS, NE, NW, ONE, SE, SW, line_of_sight

# The eight neighbours, and for each the cells of which one must be free to go there.
_DX = np.array([1, -1, 0, 0, 1, -1, 1, -1], dtype=np.int64)
_DY = np.array([0, 0, 1, -1, 1, 1, -1, -1], dtype=np.int64)
_SIDES = np.array([NE | SE, NW | SW, SW | SE, NW | NE, SE, SW, NE, NW], dtype=np.uint8)

_UNSEEN, _SEEN, _EXPANDED = 0, 1, 2


class Query(NamedTuple):
    """The map and the two ends of a search."""

    codes: NDArray  # `[H + 1, W + 1]` uint8 from `visibility.vertex_codes`
    x: NDArray  # `[2]` int64, start's and goal's x in the vertex frame, fixed point, inside free cells
    y: NDArray  # `[2]` int64, their y
    # Vertex (x, y) is node `(y << shift) + x`. The start is node `(H + 1) << shift`, the goal the one
    # after it
    shift: int


class SearchTree(NamedTuple):
    """Tree of a search: arrays of N = ((H + 1) << shift) + 2 entries, one for each node."""

    cost: NDArray  # float64, length of the shortest path from the start that is known
    heuristic: NDArray  # float64, straight distance to the goal
    parent: NDArray  # int32, the node before it on the path; the start's is itself
    state: NDArray  # uint8, 0 unseen, 1 seen, 2 expanded
    key: NDArray  # float64, for the heap
    slot: NDArray  # int32, for the heap
    order: NDArray  # int32, for the heap


@njit(nogil=True)
def node_shift(width: int) -> int:
    """Bits of a node's number that hold its column, for a grid `width` cells wide."""
    shift = 1
    while (1 << shift) <= width:
        shift += 1
    return shift


@njit(nogil=True)
def node_position(query: Query, node: int) -> tuple[int, int]:
    """A node's x and y in the vertex frame, fixed point."""
    end = node - (query.codes.shape[0] << query.shift)
    if end >= 0:
        return query.x[end], query.y[end]
    column = node & ((1 << query.shift) - 1)
    return column << FRACTION_BITS, (node >> query.shift) << FRACTION_BITS


@njit(nogil=True)
def _distance(query: Query, a: int, b: int) -> float:
    ax, ay = node_position(query, a)
    bx, by = node_position(query, b)
    dx, dy = float(bx - ax), float(by - ay)
    return np.sqrt(dx * dx + dy * dy) / ONE


@njit(nogil=True)
def _visible(query: Query, a: int, b: int) -> bool:
    ax, ay = node_position(query, a)
    bx, by = node_position(query, b)
    return line_of_sight(query.codes, ax, ay, bx, by)


@njit(nogil=True)
def _is_crossing(code: int) -> bool:
    """Two blocked cells meet here in a point: no path goes through."""
    return code == (NW | SE) or code == (NE | SW)


@njit(nogil=True)
def _relax(query: Query, tree: SearchTree, size: int, node: int, parent: int) -> int:
    """Queue `node` with a parent, not tested for visibility, if this shortens its path."""
    seen = tree.state[node] == _SEEN
    length = tree.cost[parent] + _distance(query, parent, node)
    if seen and length >= tree.cost[node] - 1e-12:
        return size
    if not seen:
        tree.state[node] = _SEEN
        tree.slot[node] = -1
        goal = (query.codes.shape[0] << query.shift) + 1
        tree.heuristic[node] = _distance(query, node, goal)
    tree.cost[node] = length
    tree.parent[node] = parent
    return heap_set(tree.order, tree.key, tree.slot, size, node, length + tree.heuristic[node])


@njit(nogil=True)
def _best_expanded_neighbour(query: Query, tree: SearchTree, node: int) -> tuple[int, float]:
    """The expanded neighbour on the shortest path to `node`, and the path's length."""
    start = query.codes.shape[0] << query.shift
    best, best_length = -1, np.inf
    if node > start:  # the goal: its neighbours are its cell's corners
        i, j = query.x[1] >> FRACTION_BITS, query.y[1] >> FRACTION_BITS
        for k in range(4):
            other = ((j + (k >> 1)) << query.shift) + i + (k & 1)
            if tree.state[other] == _EXPANDED:
                length = tree.cost[other] + _distance(query, other, node)
                if length < best_length:
                    best, best_length = other, length
        return best, best_length
    vx, vy = node & ((1 << query.shift) - 1), node >> query.shift
    code = query.codes[vy, vx]
    for k in range(8):
        if code & _SIDES[k] == _SIDES[k]:
            continue
        other = ((vy + _DY[k]) << query.shift) + vx + _DX[k]
        if tree.state[other] == _EXPANDED:
            length = tree.cost[other] + _distance(query, other, node)
            if length < best_length:
                best, best_length = other, length
    i, j = query.x[0] >> FRACTION_BITS, query.y[0] >> FRACTION_BITS
    if 0 <= vx - i <= 1 and 0 <= vy - j <= 1:
        length = _distance(query, start, node)
        if length < best_length:
            best, best_length = start, length
    return best, best_length


@njit(nogil=True)
def _expand(query: Query, tree: SearchTree, size: int, node: int) -> int:
    """Queue all neighbours of a node with its parent as theirs."""
    start = query.codes.shape[0] << query.shift
    if node == start:
        i, j = query.x[0] >> FRACTION_BITS, query.y[0] >> FRACTION_BITS
        for k in range(4):
            vx, vy = i + (k & 1), j + (k >> 1)
            if not _is_crossing(query.codes[vy, vx]):
                size = _relax(query, tree, size, (vy << query.shift) + vx, start)
        return size
    vx, vy = node & ((1 << query.shift) - 1), node >> query.shift
    code, parent = query.codes[vy, vx], np.int64(tree.parent[node])
    for k in range(8):
        if code & _SIDES[k] == _SIDES[k]:
            continue
        tx, ty = vx + _DX[k], vy + _DY[k]
        target = (ty << query.shift) + tx
        if tree.state[target] != _EXPANDED and not _is_crossing(query.codes[ty, tx]):
            size = _relax(query, tree, size, target, parent)
    i, j = query.x[1] >> FRACTION_BITS, query.y[1] >> FRACTION_BITS
    if 0 <= vx - i <= 1 and 0 <= vy - j <= 1:
        size = _relax(query, tree, size, start + 1, parent)
    return size


@njit(nogil=True)
def theta_search(query: Query, tree: SearchTree) -> bool:
    """Search a path over the vertices of the grid; True if the goal was reached.

    A vertex takes its neighbour's parent as its own without a test, and the line of sight is tested
    once, when the vertex is taken from the queue. If it is blocked, the vertex's shortest path over an
    expanded neighbour is longer than that by which it was queued, and it is queued again with the true
    length. The published algorithm expands it at once, out of order, and passes a bad parent on.
    Afterwards `tree` holds the path as the goal's ancestors.
    """
    start = query.codes.shape[0] << query.shift
    goal = start + 1
    tree.state[:] = _UNSEEN
    tree.cost[start] = 0.0
    tree.parent[start] = start
    tree.state[start] = _EXPANDED
    if _visible(query, start, goal):
        tree.parent[goal] = start
        tree.cost[goal] = _distance(query, start, goal)
        return True
    # A literal 0, and int32 for a parent, would compile `_expand` and `_relax` once more each.
    size = _expand(query, tree, np.int64(0), start)
    while size > 0:
        node = heap_pop(tree.order, tree.key, tree.slot, size)
        size -= 1
        if not _visible(query, tree.parent[node], node):
            queued = tree.cost[node]
            tree.parent[node], tree.cost[node] = _best_expanded_neighbour(query, tree, node)
            if tree.cost[node] > queued + 1e-9:
                true_key = tree.cost[node] + tree.heuristic[node]
                size = heap_set(tree.order, tree.key, tree.slot, size, node, true_key)
                continue
        tree.state[node] = _EXPANDED
        if node == goal:
            return True
        size = _expand(query, tree, size, node)
    return False


@njit(nogil=True)
def solve_over_grid(
    b: int, maps: Maps, queries: Queries, x: NDArray, y: NDArray, paths: PathArrays
) -> None:
    """Plan scene b by `theta_search`, with its map cached and its ends in free space."""
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
    if not theta_search(query, tree):
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
