"""Shortest paths from a goal pose to all poses, and the way back along them."""

import numpy as np
from numpy.typing import NDArray

from modpush._kernels import njit

__all__ = ["DIAGONAL", "descend", "search_poses"]

DIAGONAL = np.float32(np.sqrt(2.0))
_STRAIGHT = np.float32(1.0)
_QUEUES, _SEEDS = 4, 3


@njit(nogil=True)
def search_poses(cost: NDArray, turn: float, seeds: NDArray, seed_costs: NDArray) -> None:
    """Cost of the shortest path from every pose to the goal, by Dijkstra's search.

    A move leads to one of eight neighbouring positions or to a neighbouring yaw. There are three
    lengths of moves, and poses are taken in the order of their cost: those that are reached by moves of
    one length are, too. So a queue for each length does for the heap, and one for the seeds.

    Args:
        cost: `[K, R, C]` float32, contiguous, infinite where free and negative where blocked, as on
            all of the border; overwritten with the cost [steps].
        turn: Cost of a turn to the next layer [steps]; a step is the distance between positions.
        seeds: `[S]` int64, flat indices of free poses beside the goal.
        seed_costs: `[S]` float64, their costs, in ascending order.
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
    """The next pose on a shortest path to the goal.

    Args:
        cost: `[K, R, C]` float32 from `search_poses`.
        turn: Cost of a turn [steps].
        pose: `[3]` int64 (row, column, layer); the layer is not wrapped.
        after: `[3]` int64, overwritten with the next one, its layer beside the pose's.

    Returns:
        False at the path's end, beside the goal.
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
