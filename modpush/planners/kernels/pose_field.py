"""Cost-to-go over (x, y, yaw), kept from call to call, and paths read from it."""

from typing import NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from modpush._kernels import BatchKernel, njit
from modpush.planners.kernels.footprint_poses import BLOCKED, PoseGrid, mark_poses
from modpush.planners.kernels.pose_search import (
    are_joined,
    corners_around,
    cost_at,
    descend,
    find_nearest,
    is_same,
    move_cost,
    put,
    search_poses,
)


class PoseQueries(NamedTuple):
    """Maps, objects and ends of a batch; poses are (row, column, layer) of the grid, not rounded."""

    bits: NDArray  # `[B, H, ceil(W / 64)]` uint64, blocked pixels
    reach: NDArray  # `[B, N]` float64, extent of the footprint in N directions of its own [px]
    layers: NDArray  # `[B]` int64, number of yaws K
    yaw_step: NDArray  # `[B]` float64, yaw between two layers [rad]
    turn: NDArray  # `[B]` float64, cost of a turn by one layer [steps]
    start: NDArray  # `[B, 3]` float64, finite
    goal: NDArray  # `[B, 3]` float64, finite
    width: int  # W


class PoseFields(NamedTuple):
    """The last field of each scene, and what it was computed from."""

    bits: NDArray  # As in `PoseQueries`
    reach: NDArray  # As in `PoseQueries`
    sizes: NDArray  # `[B, 3]` float64, `layers`, `yaw_step` and `turn` of the query; 0 before the first
    goal: NDArray  # `[B, 3]` float64, NaN before the first
    goal_moved: NDArray  # `[B]` bool
    cost: NDArray  # `[B, K, rows + 2, columns + 2]` float32 [steps], see `search_poses`
    builds: NDArray  # `[B]` int64, number of fields built


def empty_fields(queries: PoseQueries, grid: PoseGrid, layers: int) -> PoseFields:
    """An empty cache for queries like these, with room for so many layers."""
    batch = len(queries.bits)
    shape = (batch, layers, grid.rows + 2, grid.columns + 2)
    return PoseFields(
        bits=np.zeros_like(queries.bits),
        reach=np.zeros_like(queries.reach),
        sizes=np.zeros((batch, 3)),
        goal=np.full((batch, 3), np.nan),
        goal_moved=np.zeros(batch, dtype=np.bool_),
        cost=np.full(shape, BLOCKED, dtype=np.float32),
        builds=np.zeros(batch, dtype=np.int64),
    )


@njit(nogil=True)
def _build(b: int, fields: PoseFields, cost: NDArray, turn: float) -> None:
    """Search from scene b's goal; `cost` is infinite where free."""
    goal = fields.goal[b]
    corners = np.empty((8, 3), dtype=np.int64)
    seeds, keys = np.empty(8, dtype=np.int64), np.empty(8)
    count = 0
    for i in range(corners_around(goal, cost, corners)):
        if cost_at(cost, corners[i]) >= 0.0:
            put(corners[count], corners[i])
            count += 1
    fields.goal_moved[b] = count == 0
    if count == 0:
        count = int(find_nearest(goal, cost, turn, corners[0]))
    layers, height, width = cost.shape
    for i in range(count):
        row, column, layer = corners[i, 0] + 1, corners[i, 1] + 1, corners[i, 2] % layers
        # The way to a goal that is not free is left out: it may be longer than float32 can add to.
        at, key = i, 0.0
        if not fields.goal_moved[b]:
            key = move_cost(goal, corners[i].astype(np.float64), turn)
        while at > 0 and keys[at - 1] > key:
            seeds[at], keys[at] = seeds[at - 1], keys[at - 1]
            at -= 1
        seeds[at], keys[at] = (layer * height + row) * width + column, key
    search_poses(cost, turn, seeds[:count], keys[:count])


@njit(nogil=True)
def _refresh(b: int, queries: PoseQueries, grid: PoseGrid, fields: PoseFields) -> None:
    """Build scene b's field if its map, object or goal differ from the last."""
    sizes = np.array((float(queries.layers[b]), queries.yaw_step[b], queries.turn[b]))
    same_map = (
        is_same(sizes, fields.sizes[b])
        and is_same(queries.reach[b], fields.reach[b])
        and is_same(queries.bits[b], fields.bits[b])
    )
    cost = fields.cost[b, : queries.layers[b]]
    if same_map and is_same(queries.goal[b], fields.goal[b]):
        return
    if same_map:
        flat = cost.reshape(-1)
        for i in range(flat.size):
            flat[i] = np.inf if flat[i] >= 0.0 else flat[i]
    else:
        put(fields.sizes[b], sizes)
        put(fields.reach[b], queries.reach[b])
        put(fields.bits[b], queries.bits[b])
        mark_poses(queries.bits[b], queries.width, queries.reach[b], sizes[1], grid, cost)
    put(fields.goal[b], queries.goal[b])
    _build(b, fields, cost, queries.turn[b])
    fields.builds[b] += 1


@BatchKernel
def refresh_fields(batch: int, queries: PoseQueries, grid: PoseGrid, fields: PoseFields) -> None:
    """Build the fields of the scenes in which something differs from the last query."""
    for b in prange(batch):
        _refresh(b, queries, grid, fields)


class PosePathArrays(NamedTuple):
    """Arrays for a batch of paths; see `modpush.planners.PosePaths`."""

    waypoints: NDArray  # `[B, capacity, 3]` float64 (row, column, layer), the layer not wrapped
    along: NDArray  # `[B, capacity]` float64, cost from the start to each waypoint [steps]
    # `[B]` int64, the paths' numbers of waypoints, also where they exceed the capacity
    sizes: NDArray
    start_moved: NDArray  # `[B]` bool
    goal_moved: NDArray  # `[B]` bool


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
    """Write the pose of the grid by which a path begins; is there one, and was the start moved?"""
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
