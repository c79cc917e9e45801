"""Theta*: A* over the grid whose paths may turn by any angle."""

from modpush._batching import run_batch
from modpush.planners.grid_planner import GridPlanner
from modpush.planners.kernels.maps import Maps
from modpush.planners.kernels.paths import PathArrays, Queries
from modpush.planners.kernels.theta_star import plan_few, plan_many

__all__ = ["ThetaStar"]


class ThetaStar(GridPlanner):
    """Theta* over the cells' corners, 8-connected, with a line-of-sight test at every step.

    Not exact: on the maps of `benchmarks/bench_planners.py` paths are 0.02 % too long on average and
    1 % at worst.

    Args:
        cell_size: Metres per pixel; lengths are given in pixels times this.

    Source: Nash, Daniel, Koenig, Felner, "Theta*: Any-Angle Path Planning on Grids" (AAAI 2007).
    """

    def _run(self, maps: Maps, queries: Queries, paths: PathArrays) -> None:
        run_batch(plan_few, plan_many, len(queries.cells), maps, queries, paths)
