"""Lazy Theta*, the paper's planner, over convex corners or over the whole grid."""

from typing import Literal

import numpy as np

from modpush._types import Positive
from modpush._validation import checked_arguments
from modpush.planners.grid_planner import GridPlanner
from modpush.planners.kernels.maps import Maps, PathArrays, Queries
from modpush.planners.kernels.taut_search import (
    plan_over_corners,
    plan_over_grid,
    plan_what_is_left,
)

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
