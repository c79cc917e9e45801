"""Planners whose paths bend at obstacles' corners: Lazy Theta*, a field for one goal, the line."""

from typing import Literal

import numpy as np
from numba import prange

from modpush._kernels import BatchKernel, PerThread
from modpush._types import Positive
from modpush._validation import checked_arguments
from modpush.planners.grid_planner import GridPlanner
from modpush.planners.kernels.distance_field import Fields, empty_fields, plan_over_fields
from modpush.planners.kernels.maps import (
    Maps,
    PathArrays,
    Queries,
    place_ends,
    refresh_map,
    write_path,
)
from modpush.planners.kernels.taut_search import (
    plan_over_corners,
    plan_over_grid,
    plan_what_is_left,
)
from modpush.planners.kernels.visibility import line_of_sight

Nodes = Literal["corners", "grid"]


class LazyThetaStar(GridPlanner):
    """Lazy Theta*: any-angle A* that tests a line of sight only when its edge is about to be used.

    `nodes="grid"` is the published search over the whole grid, from vertex to neighbouring vertex,
    with two corrections, without which its paths were up to 28 % too long. First, a vertex whose
    assumed parent is not visible has a longer path than that by which it was queued; it returns to the
    queue instead of being expanded too early. Second, paths run over the cells' corners, where
    shortest paths bend, rather than over their centres. The paths were up to 1.1 % above the optimum
    on the maps of `benchmarks/bench_planners.py` and up to 3.3 % on a map of noise; there is no bound
    for all maps.

    `nodes="corners"`, the default, keeps the lazy rule but searches only the convex corners of
    blocked cells, each of which is a neighbour of all others. This is exact, and much faster for few
    corners. A map with more than 2048 of them (noise; ten inflated bars have 440) is searched over
    the grid instead.

    Args:
        cell_size: Metres per pixel; lengths are given in pixels times this.
        nodes: `"corners"` or `"grid"`.

    Raises:
        ValueError: If `nodes` is neither of them.

    Source: Nash, Koenig, Tovey, "Lazy Theta*: Any-Angle Path Planning and Path Length Analysis in
        3D" (AAAI 2010), heuristic weight 1, 8-connected.
    """

    @checked_arguments
    def __init__(self, cell_size: Positive = 1.0, nodes: Nodes = "corners") -> None:
        super().__init__(cell_size)
        self.nodes = nodes

    def _run(self, maps: Maps, queries: Queries, paths: PathArrays) -> None:
        batch = len(queries.cells)
        if self.nodes == "grid":
            plan_over_grid(batch, np.arange(batch), maps, queries, paths)
        else:
            plan_over_corners(batch, maps, queries, paths)
            plan_what_is_left(maps, queries, paths)


class DistanceField(GridPlanner):
    """Exact paths of a moving object to a fixed goal on a fixed map.

    The first query of a scene without a straight line to its goal builds the field: the shortest paths
    from every corner to the goal. Later queries search only the first corner of their path. Maps and
    goals are compared with those of the field, which is rebuilt scene by scene where they differ, so
    that the paths are always those of `LazyThetaStar`. A map with more than 2048 corners is searched
    over the grid at each query, as in `LazyThetaStar`.

    Args:
        cell_size: Metres per pixel; lengths are given in pixels times this.
    """

    def __init__(self, cell_size: float = 1.0) -> None:
        super().__init__(cell_size)
        self._fields: PerThread[Fields] = PerThread()

    @property
    def builds(self) -> int:
        """Number of fields that the calling thread has built since its batch size last changed."""
        fields = self._fields.value
        return 0 if fields is None else int(fields.builds.sum())

    def _run(self, maps: Maps, queries: Queries, paths: PathArrays) -> None:
        batch = len(queries.cells)
        fields = self._fields.value
        if fields is None or len(fields.goal) != batch:
            fields = self._fields.value = empty_fields(batch)
        plan_over_fields(batch, maps, queries, paths, fields)
        plan_what_is_left(maps, queries, paths)


@BatchKernel
def _plan_straight(batch: int, maps: Maps, queries: Queries, paths: PathArrays) -> None:
    """Plan all scenes."""
    for b in prange(batch):
        x, y = np.empty(2, dtype=np.int64), np.empty(2, dtype=np.int64)
        refresh_map(maps, b, queries.cells[b])
        if place_ends(maps, b, queries, x, y, paths) and line_of_sight(
            maps.codes[b], x[0], y[0], x[1], y[1]
        ):
            write_path(paths, b, queries, x, y)


class StraightLine(GridPlanner):
    """The straight line from start to goal, found only where it crosses no blocked cell.

    Args:
        cell_size: Metres per pixel; lengths are given in pixels times this.
    """

    def _run(self, maps: Maps, queries: Queries, paths: PathArrays) -> None:
        _plan_straight(len(queries.cells), maps, queries, paths)
