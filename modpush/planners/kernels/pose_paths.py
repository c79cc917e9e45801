"""Paths that are read from the cost-to-go over (x, y, yaw)."""

from typing import NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from modpush._kernels import BatchKernel, njit
from modpush.planners.kernels.pose_field import PoseFields, PoseQueries
from modpush.planners.kernels.pose_search import (
    are_joined,
    corners_around,
    cost_at,
    descend,
    find_nearest,
    is_same,
    move_cost,
    put,
)


class PosePathArrays(NamedTuple):
    """Arrays for a batch of paths; see `modpush.planners.PosePaths`.

    Attributes:
        waypoints: `[B, capacity, 3]` float64 (row, column, layer), the layer not wrapped.
        along: `[B, capacity]` float64, cost from the start to each waypoint [steps].
        sizes: `[B]` int64, the paths' numbers of waypoints, also where they exceed the capacity.
        start_moved: `[B]` bool.
        goal_moved: `[B]` bool.
    """

    waypoints: NDArray
    along: NDArray
    sizes: NDArray
    start_moved: NDArray
    goal_moved: NDArray


@njit(nogil=True)
def _trace(node: NDArray, cost: NDArray, turn: float, start: NDArray, goal: NDArray) -> NDArray:
    """Start, the grid's poses on the shortest path from a node, and goal, `[P, 3]` float64."""
    layers = len(cost)
    most = int(cost_at(cost, node) / min(1.0, turn)) + 4  # no move costs less
    trace = np.empty((most, 3))
    put(trace[0], start)
    put(trace[1], node)
    at, after = np.empty(3, dtype=np.int64), np.empty(3, dtype=np.int64)
    at[0], at[1], at[2] = node[0] + 1, node[1] + 1, node[2]  # with the border
    count = 2
    while count < most - 1 and descend(cost, turn, at, after):
        put(at, after)
        trace[count, 0], trace[count, 1], trace[count, 2] = at[0] - 1, at[1] - 1, at[2]
        count += 1
    put(trace[count], goal)
    trace[count, 2] += layers * np.rint((at[2] - goal[2]) / layers)
    return trace[: count + 1]


@njit(nogil=True)
def _enter(start: NDArray, cost: NDArray, turn: float, node: NDArray) -> tuple[bool, bool]:
    """Find the grid's pose by which a path from a start begins.

    Returns:
        True if there is a path, and True if the start is not free.
    """
    corners = np.empty((8, 3), dtype=np.int64)
    best, is_free = np.inf, False
    for i in range(corners_around(start, cost, corners)):
        value = cost_at(cost, corners[i])
        is_free = is_free or value >= 0.0
        length = value + move_cost(start, corners[i].astype(np.float64), turn)
        if value >= 0.0 and length < best:
            best = length
            put(node, corners[i])
    if is_free:
        return best < np.inf, False
    found = find_nearest(start, cost, turn, node)
    return found and cost_at(cost, node) < np.inf, True


@njit(nogil=True)
def _write_from(paths: PosePathArrays, b: int, first: int, pose: NDArray, along: float) -> None:
    """Write one pose to all of scene b's waypoints from the first one on."""
    for i in range(first, paths.along.shape[1]):
        put(paths.waypoints[b, i], pose)
        paths.along[b, i] = along


@njit(nogil=True)
def _read_path(b: int, queries: PoseQueries, fields: PoseFields, paths: PosePathArrays) -> None:
    """Write scene b's path: that of the field, with straight legs where they are free."""
    cost = fields.cost[b, : queries.layers[b]]
    turn, start = queries.turn[b], queries.start[b]
    node = np.empty(3, dtype=np.int64)
    found, start_moved = _enter(start, cost, turn, node)
    goal_moved = fields.goal_moved[b]
    paths.sizes[b] = 0
    _write_from(paths, b, 0, start, 0.0)
    paths.start_moved[b], paths.goal_moved[b] = start_moved, goal_moved
    if is_same(start, queries.goal[b]):
        paths.sizes[b] = 2  # also where they are blocked: they need not be left and entered again
        return
    if not found:
        return
    trace = _trace(node, cost, turn, start, queries.goal[b])
    # The legs to ends that were moved stay as they are.
    first, last = 0, len(trace) - 1
    length, size = 0.0, 1
    while first < last:
        to = last - 1 if goal_moved and first < last - 1 else last
        if first == 0 and start_moved:
            to = 1
        while to > first + 1 and not are_joined(trace[first], trace[to], cost):
            to -= 1
        length += move_cost(trace[first], trace[to], turn)
        _write_from(paths, b, size, trace[to], length)
        size += 1
        first = to
    paths.sizes[b] = size


@BatchKernel
def read_paths(batch: int, queries: PoseQueries, fields: PoseFields, paths: PosePathArrays) -> None:
    """Write the paths of all scenes from their fields."""
    for b in prange(batch):
        _read_path(b, queries, fields, paths)
