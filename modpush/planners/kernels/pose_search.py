"""Poses as nodes of a graph, shortest paths from a goal pose to all of them, and paths back."""

import numpy as np
from numpy.typing import NDArray

from modpush._kernels import njit

_SAME = 1e-6  # [steps]; a pose so near to one row of the grid is not between two


@njit(nogil=True)
def is_same(first: NDArray, second: NDArray) -> bool:
    """True if two arrays of one shape have equal values."""
    one, other = first.ravel(), second.ravel()
    same = True
    for i in range(one.size):
        same = same and one[i] == other[i]
    return same


@njit(nogil=True)
def put(target: NDArray, source: NDArray) -> None:
    """Copy an array into another of its shape; numba takes seconds to compile `target[:] = source`."""
    into, values = target.ravel(), source.ravel()
    for i in range(into.size):
        into[i] = values[i]


@njit(nogil=True)
def move_cost(first: NDArray, second: NDArray, turn: float) -> float:
    """Cost of the straight way between two poses, layers as they are [steps]."""
    way = np.sqrt((second[0] - first[0]) ** 2 + (second[1] - first[1]) ** 2)
    return way + turn * abs(second[2] - first[2])


@njit(nogil=True)
def corners_around(pose: NDArray, cost: NDArray, corners: NDArray) -> int:
    """Write the grid's poses around a pose, of which it may be one itself, and return their number.

    They are `[8, 3]` int64 (row, column, layer), the layer not wrapped; none for a pose more than half a
    step outside the grid.
    """
    layers, height, width = cost.shape
    low, high = np.empty(3, dtype=np.int64), np.empty(3, dtype=np.int64)
    for axis in range(3):
        value, size = pose[axis], (height - 2, width - 2, 0)[axis]
        if axis < 2:
            if value < -0.5 or value > size - 0.5:
                return 0
            value = min(max(value, 0.0), size - 1.0)
        low[axis], high[axis] = int(np.floor(value + _SAME)), int(np.ceil(value - _SAME))
    if layers == 1:
        high[2] = low[2]
    count = 0
    for row in range(low[0], high[0] + 1):
        for column in range(low[1], high[1] + 1):
            for layer in range(low[2], high[2] + 1):
                corners[count, 0], corners[count, 1], corners[count, 2] = row, column, layer
                count += 1
    return count


@njit(nogil=True)
def cost_at(cost: NDArray, node: NDArray) -> float:
    return cost[node[2] % len(cost), node[0] + 1, node[1] + 1]


@njit(nogil=True)
def find_nearest(pose: NDArray, cost: NDArray, turn: float, node: NDArray) -> bool:
    """Find the free pose of the grid nearest to a pose; False if there is none."""
    layers, height, width = cost.shape
    best, found = np.inf, False
    at = np.empty(3)
    for k in range(layers):
        # The equivalent yaw nearest to the pose's.
        layer = k + layers * int(np.rint((pose[2] - k) / layers))
        for row in range(height - 2):
            for column in range(width - 2):
                if cost[k, row + 1, column + 1] < 0.0:
                    continue
                at[0], at[1], at[2] = row, column, layer
                length = move_cost(pose, at, turn)
                if length < best:
                    best, found = length, True
                    node[0], node[1], node[2] = row, column, layer
    return found


@njit(nogil=True)
def are_joined(first: NDArray, second: NDArray, cost: NDArray) -> bool:
    """True if all of the grid's poses around the straight way between two poses are free."""
    corners, pose = np.empty((8, 3), dtype=np.int64), np.empty(3)
    steps = max(1, int(np.ceil(2.0 * np.abs(second - first).max() - _SAME)))
    for i in range(steps + 1):
        for axis in range(3):
            pose[axis] = first[axis] + (second[axis] - first[axis]) * (i / steps)
        count = corners_around(pose, cost, corners)
        for j in range(count):
            if cost_at(cost, corners[j]) < 0.0:
                return False
        if count == 0:
            return False
    return True


DIAGONAL = np.float32(np.sqrt(2.0))
_STRAIGHT = np.float32(1.0)
_QUEUES, _SEEDS = 4, 3


@njit(nogil=True)
def search_poses(cost: NDArray, turn: float, seeds: NDArray, seed_costs: NDArray) -> None:
    """Cost of the shortest path from every pose to the goal, by Dijkstra's search.

    A move leads to one of eight neighbouring positions or to a neighbouring yaw. There are three lengths
    of moves, and poses are taken in the order of their cost: those that are reached by moves of one
    length are, too. So a queue for each length does for the heap, and one for the seeds. `cost` `[K, R,
    C]` float32, infinite where free and negative where blocked, as on all of the border, is overwritten
    [steps]; `turn` is the cost of a turn to the next layer [steps]. The seeds `[S]` are flat indices of
    free poses beside the goal, in the order of their costs.
    """
    layers, height, width = cost.shape
    layer, last = height * width, (layers - 1) * height * width
    flat = cost.reshape(-1)
    moves = np.array((-width, 1, width, -1, 1 - width, 1 + width, width - 1, -width - 1, 0, 0))
    lengths = np.array((_STRAIGHT, DIAGONAL, np.float32(turn), np.float32(0.0)))
    # A pose enters a queue at most once, since the second time its cost would not be lower.
    nodes = np.empty((_QUEUES, flat.size), dtype=np.int32)
    keys = np.empty((_QUEUES, flat.size), dtype=np.float32)
    heads, tails = np.zeros(_QUEUES, dtype=np.int64), np.zeros(_QUEUES, dtype=np.int64)
    for i in range(len(seeds)):
        flat[seeds[i]] = seed_costs[i]
        nodes[_SEEDS, i], keys[_SEEDS, i] = seeds[i], seed_costs[i]
    tails[_SEEDS] = len(seeds)
    while True:
        queue, key = -1, np.float32(np.inf)
        for q in range(_QUEUES):
            if heads[q] < tails[q] and keys[q, heads[q]] < key:
                queue, key = q, keys[q, heads[q]]
        if queue < 0:
            return
        node = np.int64(nodes[queue, heads[queue]])
        heads[queue] += 1
        if key > flat[node]:
            continue  # reached on a shorter way since
        # The turns wrap around.
        moves[8] = layer if node < last else -last
        moves[9] = -layer if node >= layer else last
        for i in range(10 if layers > 1 else 8):
            to = node + moves[i]
            q = i >> 2
            length = key + lengths[q]
            # A diagonal i lies between straight moves i - 4 and i - 3 and cuts no corner.
            if length < flat[to] and (
                q != 1
                or (flat[node + moves[i - 4]] >= 0.0 and flat[node + moves[(i - 3) & 3]] >= 0.0)
            ):
                flat[to] = length
                nodes[q, tails[q]], keys[q, tails[q]] = to, length
                tails[q] += 1


@njit(nogil=True)
def descend(cost: NDArray, turn: float, pose: NDArray, after: NDArray) -> bool:
    """Write the next pose on a shortest path to the goal; False at its end, beside the goal.

    `cost` is of `search_poses`; poses are `[3]` int64 (row, column, layer), the layer not wrapped.
    """
    layers = len(cost)
    row, column, layer = pose[0], pose[1], pose[2]
    here = cost[layer % layers]
    best = here[row, column]
    found = False
    for dr in range(-1, 2):
        for dc in range(-1, 2):
            if dr == 0 and dc == 0:
                continue
            value = here[row + dr, column + dc]
            if value < 0.0:
                continue
            length = _STRAIGHT
            if dr != 0 and dc != 0:
                if here[row + dr, column] < 0.0 or here[row, column + dc] < 0.0:
                    continue
                length = DIAGONAL
            if value + length <= best:
                best, found = value + length, True
                after[0], after[1], after[2] = row + dr, column + dc, layer
    if layers > 1:
        for dk in (-1, 1):
            value = cost[(layer + dk) % layers, row, column]
            if value >= 0.0 and value + np.float32(turn) <= best:
                best, found = value + np.float32(turn), True
                after[0], after[1], after[2] = row, column, layer + dk
    return found
