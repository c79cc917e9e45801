"""The search that Theta* and Lazy Theta* share: A* over the cells' corners, with far parents.

Source: Nash, Daniel, Koenig, Felner, "Theta*: Any-Angle Path Planning on Grids" (AAAI 2007); Nash,
Koenig, Tovey, "Lazy Theta*: Any-Angle Path Planning and Path Length Analysis in 3D" (AAAI 2010).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from modpush._kernels import njit
from modpush.planners.kernels.heap import heap_pop, heap_set
from modpush.planners.kernels.visibility import FRACTION_BITS, NE, NW, ONE, SE, SW, line_of_sight

# The eight neighbours, and for each the cells of which one must be free to go there.
_DX = np.array([1, -1, 0, 0, 1, -1, 1, -1], dtype=np.int64)
_DY = np.array([0, 0, 1, -1, 1, 1, -1, -1], dtype=np.int64)
_SIDES = np.array([NE | SE, NW | SW, SW | SE, NW | NE, SE, SW, NE, NW], dtype=np.uint8)

_UNSEEN, _SEEN, _EXPANDED = 0, 1, 2


class Query(NamedTuple):
    """Where to search: the map and the two ends.

    Attributes:
        codes: `[H + 1, W + 1]` uint8 from `visibility.vertex_codes`.
        x: `[2]` int64, start's and goal's x in the vertex frame, fixed point, inside free cells.
        y: `[2]` int64, their y.
        shift: Vertex (x, y) is node `(y << shift) + x`. The start is node `(H + 1) << shift`, the
            goal the one after it.
    """

    codes: NDArray
    x: NDArray
    y: NDArray
    shift: int


class SearchTree(NamedTuple):
    """What the search knows of each node: arrays of N = ((H + 1) << shift) + 2 entries.

    Attributes:
        cost: float64, length of the way from the start, so far as known.
        heuristic: float64, straight distance to the goal.
        parent: int32, the node before it; the start's is itself.
        state: uint8, 0 unseen, 1 seen, 2 expanded.
        key: float64, for the heap.
        slot: int32, for the heap.
        order: int32, for the heap.
    """

    cost: NDArray
    heuristic: NDArray
    parent: NDArray
    state: NDArray
    key: NDArray
    slot: NDArray
    order: NDArray


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
def _relax(
    query: Query, tree: SearchTree, size: int, node: int, near: int, far: int, lazy: bool
) -> int:
    """Offer `node` a way over its expanded neighbour `near` or over that one's parent `far`."""
    seen = tree.state[node] == _SEEN
    length = tree.cost[far] + _distance(query, far, node)
    if seen and length >= tree.cost[node] - 1e-12:
        return size
    if not lazy and not _visible(query, far, node):
        far = near
        length = tree.cost[near] + _distance(query, near, node)
        if seen and length >= tree.cost[node] - 1e-12:
            return size
    if not seen:
        tree.state[node] = _SEEN
        tree.slot[node] = -1
        goal = (query.codes.shape[0] << query.shift) + 1
        tree.heuristic[node] = _distance(query, node, goal)
    tree.cost[node] = length
    tree.parent[node] = far
    return heap_set(tree.order, tree.key, tree.slot, size, node, length + tree.heuristic[node])


@njit(nogil=True)
def _best_expanded_neighbour(query: Query, tree: SearchTree, node: int) -> tuple[int, float]:
    """The expanded neighbour over which `node` is reached soonest, and the way's length."""
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
def _expand(query: Query, tree: SearchTree, size: int, node: int, lazy: bool) -> int:
    """Offer a node's way to all its neighbours."""
    start = query.codes.shape[0] << query.shift
    if node == start:
        i, j = query.x[0] >> FRACTION_BITS, query.y[0] >> FRACTION_BITS
        for k in range(4):
            vx, vy = i + (k & 1), j + (k >> 1)
            if not _is_crossing(query.codes[vy, vx]):
                size = _relax(query, tree, size, (vy << query.shift) + vx, start, start, lazy)
        return size
    vx, vy = node & ((1 << query.shift) - 1), node >> query.shift
    code, far = query.codes[vy, vx], tree.parent[node]
    for k in range(8):
        if code & _SIDES[k] == _SIDES[k]:
            continue
        tx, ty = vx + _DX[k], vy + _DY[k]
        target = (ty << query.shift) + tx
        if tree.state[target] != _EXPANDED and not _is_crossing(query.codes[ty, tx]):
            size = _relax(query, tree, size, target, node, far, lazy)
    i, j = query.x[1] >> FRACTION_BITS, query.y[1] >> FRACTION_BITS
    if 0 <= vx - i <= 1 and 0 <= vy - j <= 1:
        size = _relax(query, tree, size, start + 1, node, far, lazy)
    return size


@njit(nogil=True)
def theta_search(query: Query, tree: SearchTree, lazy: bool) -> bool:
    """Search a path over the vertices of the grid.

    With `lazy`, a vertex takes its neighbour's parent as its own unseen, and the line of sight is
    asked for once, when the vertex is taken from the queue. If there is none, its best way over an
    expanded neighbour is longer than its place in the queue promised, and it goes back into the
    queue with the true value. The published algorithm expands it at once all the same, out of
    turn, and hands a bad parent on to all that follow.

    Args:
        query: Map and ends.
        tree: Scratch; afterwards it holds the search tree, and the path as the goal's ancestors.
        lazy: Lazy Theta* rather than Theta*.

    Returns:
        True if the goal was reached.
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
    size = _expand(query, tree, 0, start, lazy)
    while size > 0:
        node = heap_pop(tree.order, tree.key, tree.slot, size)
        size -= 1
        if lazy and not _visible(query, tree.parent[node], node):
            promised = tree.cost[node]
            tree.parent[node], tree.cost[node] = _best_expanded_neighbour(query, tree, node)
            if tree.cost[node] > promised + 1e-9:
                true_key = tree.cost[node] + tree.heuristic[node]
                size = heap_set(tree.order, tree.key, tree.slot, size, node, true_key)
                continue
        tree.state[node] = _EXPANDED
        if node == goal:
            return True
        size = _expand(query, tree, size, node, lazy)
    return False
