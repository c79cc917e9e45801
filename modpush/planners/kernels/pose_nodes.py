"""The poses of the grid beside any pose (row, column, layer), and the ways between poses."""

import numpy as np
from numpy.typing import NDArray

from modpush._kernels import njit

__all__ = ["are_joined", "corners_around", "cost_at", "find_nearest", "is_same", "move_cost", "put"]

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
    """List the grid's poses around a pose, of which it may be one itself.

    Args:
        pose: `[3]` float64.
        cost: `[K, rows + 2, columns + 2]`.
        corners: `[8, 3]` int64, overwritten with (row, column, layer), the layer not wrapped.

    Returns:
        Their number; 0 for a pose more than half a step outside the grid.
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
