"""The base of the planners whose searches are compiled."""

from abc import abstractmethod
from typing import Any

import torch
from torch import Tensor

from modpush.planners.base import Paths, Planner
from modpush.planners.kernels.maps import Maps, empty_maps
from modpush.planners.kernels.paths import PathArrays, Queries, empty_paths
from modpush.planners.per_thread import PerThread

__all__ = ["GridPlanner"]


class GridPlanner(Planner):
    """Implement `_run`: a planner whose search is compiled, with memory of the last maps.

    The memory only saves work: it is checked against the map of every call, and each thread has its
    own. So a planner may be shared by threads, copied, pickled, and asked about any scenes in any
    order.

    Args:
        cell_size: Metres per pixel; lengths are given in pixels times this.
    """

    def __init__(self, cell_size: float = 1.0) -> None:
        super().__init__(cell_size)
        self._maps: PerThread[Maps] = PerThread()
        self._capacity = 64  # waypoints; grows with the first path that needs more

    def _plan(self, occupancy: Tensor, start: Tensor, goal: Tensor, *options: Any) -> Paths:
        maps = self._maps.value
        if maps is None or maps.cells.shape != occupancy.shape:
            maps = self._maps.value = empty_maps(*occupancy.shape)
        cells = occupancy.view(torch.uint8).numpy()
        queries = Queries(cells, start.numpy(), goal.numpy(), self.cell_size)
        capacity = self._capacity
        while True:
            paths = empty_paths(len(cells), capacity)
            self._run(maps, queries, paths, *options)
            needed = int(paths.sizes.max(initial=0))
            if needed <= capacity:
                return _to_paths(paths, max(2, needed))
            capacity = self._capacity = 2 * needed

    @abstractmethod
    def _run(self, maps: Maps, queries: Queries, paths: PathArrays) -> None:
        """Write a path for each scene.

        Args:
            maps: This thread's memory of the last maps, `[B, ...]`.
            queries: Cells and ends of B scenes.
            paths: Where to write.
        """


def _to_paths(arrays: PathArrays, longest: int) -> Paths:
    """Wrap what a kernel wrote; the waypoints are cut to the longest path's."""
    return Paths(
        waypoints=torch.from_numpy(arrays.waypoints)[:, :longest],
        count=torch.from_numpy(arrays.sizes),
        length=torch.from_numpy(arrays.length),
        found=torch.from_numpy(arrays.found),
        start_moved=torch.from_numpy(arrays.start_moved),
        goal_moved=torch.from_numpy(arrays.goal_moved),
    )
