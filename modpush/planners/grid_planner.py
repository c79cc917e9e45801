"""`Planner`: a map, a start and a goal in, paths out; and the base class of compiled searches."""

from abc import ABC, abstractmethod
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from modpush._checks import check_dtype, check_shape
from modpush._kernels import PerThread
from modpush._types import Positive
from modpush._validation import checked_arguments
from modpush.planners.kernels.maps import Maps, PathArrays, Queries, empty_maps, empty_paths
from modpush.planners.kernels.visibility import MAX_SIDE
from modpush.planners.paths import Paths


class Planner(ABC):
    """Implement `plan`: a path for each of a batch of maps.

    `PlannerSubgoals` uses it in a transform: it passes checked arguments and checks the result.

    Args:
        cell_size: Metres per pixel; lengths are given in pixels times this.

    Raises:
        ValueError: If `cell_size` is not positive and finite.
    """

    @checked_arguments
    def __init__(self, cell_size: Positive = 1.0) -> None:
        self.cell_size = float(cell_size)

    @abstractmethod
    def plan(self, occupancy: Tensor, start: Tensor, goal: Tensor) -> Paths:
        """Plan one path per scene.

        Args:
            occupancy: `[B, H, W]` bool, True where blocked; H and W from 1 to 4096.
            start: `[B, 2]` float (u, v) [px]; any finite point, see `Paths` for ends that are not
                free.
            goal: `[B, 2]` float (u, v) [px]; the same.

        Returns:
            The paths, on the occupancy's device; `Paths.from_waypoints` makes them of lists.
        """


class GridPlanner(Planner):
    """Implement `_run`: a planner with a compiled search and a cache of the last maps.

    The cache only saves time: it is compared with the map of every call, and each thread has its own. A
    planner may therefore be shared by threads, copied and pickled, and plan for any scenes in any order.
    """

    def __init__(self, cell_size: float = 1.0) -> None:
        super().__init__(cell_size)
        self._maps: PerThread[Maps] = PerThread()
        self._capacity = 64  # waypoints; grows with the first path that needs more

    def plan(self, occupancy: Tensor, start: Tensor, goal: Tensor) -> Paths:
        """Plan one path per scene, see `Planner.plan`.

        Raises:
            TypeError: If the occupancy is not a bool tensor, or an end is not a floating-point tensor.
            ValueError: If the shapes do not match, or an end is not finite.
        """
        return self._plan(occupancy, start, goal)

    def _plan(self, occupancy: Tensor, start: Tensor, goal: Tensor, *options: Any) -> Paths:
        """`plan`, with further arguments for `_run`."""
        name = type(self).__name__
        check_dtype("occupancy", occupancy, torch.bool)
        if occupancy.ndim != 3 or not all(1 <= side <= MAX_SIDE for side in occupancy.shape[1:]):
            raise ValueError(
                f"{name}: occupancy must be [B, H, W] with H and W from 1 to {MAX_SIDE}, got "
                f"{list(occupancy.shape)}."
            )
        ends = [_checked_end("start", start, len(occupancy))]
        ends.append(_checked_end("goal", goal, len(occupancy)))
        if occupancy.device.type == "cpu":
            return self._search(occupancy.contiguous(), *ends, *options)
        return self._search(occupancy.cpu().contiguous(), *ends, *options).to(occupancy.device)

    def _search(
        self,
        occupancy: Tensor,
        start: NDArray[np.float32],
        goal: NDArray[np.float32],
        *options: Any,
    ) -> Paths:
        """Run the kernels, and again with more room where a path is longer than the arrays."""
        maps = self._maps.value
        if maps is None or maps.cells.shape != occupancy.shape:
            maps = self._maps.value = empty_maps(*occupancy.shape)
        cells = occupancy.view(torch.uint8).numpy()
        queries = Queries(cells, start, goal, self.cell_size)
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
        """Write a path for each of B scenes, with this thread's cache of the last maps."""


def _checked_end(name: str, point: Tensor, batch: int) -> NDArray[np.float32]:
    """Starts or goals as `[B, 2]` float32, all finite."""
    if not (isinstance(point, Tensor) and point.is_floating_point()):
        got = point.dtype if isinstance(point, Tensor) else type(point).__name__
        raise TypeError(f"{name} must be a floating point tensor, got {got}.")
    check_shape(name, point, "B, 2", (batch, 2))
    values = point.detach().to("cpu", torch.float32).contiguous().numpy()
    finite = np.isfinite(values)  # several times faster than torch on so few numbers
    if not finite.all():
        scenes = (~finite).any(-1).nonzero()[0].tolist()
        raise ValueError(f"{name} is not finite in scene(s) {scenes}.")
    return values


def _to_paths(arrays: PathArrays, longest: int) -> Paths:
    """The paths that a kernel has written, with as many waypoints as the longest path has."""
    return Paths(
        waypoints=torch.from_numpy(arrays.waypoints)[:, :longest],
        count=torch.from_numpy(arrays.sizes),
        length=torch.from_numpy(arrays.length),
        found=torch.from_numpy(arrays.found),
        start_moved=torch.from_numpy(arrays.start_moved),
        goal_moved=torch.from_numpy(arrays.goal_moved),
    )
