"""The straight line, a baseline for comparisons and tests."""

from modpush.planners.grid_planner import GridPlanner
from modpush.planners.kernels.maps import Maps
from modpush.planners.kernels.paths import PathArrays, Queries
from modpush.planners.kernels.straight_line import plan_all

__all__ = ["StraightLine"]


class StraightLine(GridPlanner):
    """The straight line from start to goal, found only where it crosses no blocked cell.

    Args:
        cell_size: Metres per pixel; lengths are given in pixels times this.
    """

    def _run(self, maps: Maps, queries: Queries, paths: PathArrays) -> None:
        plan_all(len(queries.cells), maps, queries, paths)
