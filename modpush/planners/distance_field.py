"""Shortest paths to one goal from a field that is built once and read as the object moves."""

from modpush._kernels import PerThread
from modpush.planners.grid_planner import GridPlanner
from modpush.planners.kernels.distance_field import Fields, empty_fields, plan_all
from modpush.planners.kernels.maps import Maps, PathArrays, Queries
from modpush.planners.kernels.taut_search import plan_what_is_left


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
        plan_all(batch, maps, queries, paths, fields)
        plan_what_is_left(maps, queries, paths)
