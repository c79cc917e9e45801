"""A* from cell to cell, optionally with a cost for each cell."""

import math
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from modpush._checks import check_real
from modpush._types import Positive
from modpush._validation import checked_arguments
from modpush.planners.grid_planner import GridPlanner
from modpush.planners.kernels.a_star import plan_all
from modpush.planners.kernels.maps import Maps, PathArrays, Queries
from modpush.planners.paths import Paths

_SAME_EVERYWHERE = np.ones((1, 1, 1), dtype=np.float32)


class AStar(GridPlanner):
    """A* over cells with 4 or 8 neighbours, never cutting a blocked cell's corner.

    Optimal among the paths from cell centre to cell centre; the first and the last leg join them to
    ends that are not at a centre. `Paths.length` is the path's length, also where a weight was
    minimised instead.

    Args:
        cell_size: Metres per pixel; lengths are given in pixels times this.
        neighbours: 4 or 8.

    Raises:
        ValueError: If `neighbours` is neither.

    Source: Hart, Nilsson, Raphael, "A Formal Basis for the Heuristic Determination of Minimum Cost
        Paths" (1968).
    """

    @checked_arguments
    def __init__(self, cell_size: Positive = 1.0, neighbours: Literal[4, 8] = 8) -> None:
        super().__init__(cell_size)
        self.neighbours = neighbours

    def plan_weighted(
        self, occupancy: Tensor, weight: Tensor, start: Tensor, goal: Tensor
    ) -> Paths:
        """Plan paths of least weight: a step costs its length times the mean weight of its two cells.

        Args:
            occupancy: `[B, H, W]` bool, True where blocked.
            weight: `[B, H, W]` float32, positive; read where free.
            start: `[B, 2]` float (u, v) [px].
            goal: `[B, 2]` float (u, v) [px].

        Raises:
            TypeError: As for `plan`.
            ValueError: If the weight is not positive and finite, or not of the occupancy's shape; and as
                for `plan`.
        """
        for name, value in (("occupancy", occupancy), ("weight", weight)):
            if not isinstance(value, Tensor):
                raise TypeError(f"AStar: {name} must be a tensor, got {type(value).__name__}.")
        if weight.shape != occupancy.shape:
            raise ValueError(
                f"AStar: weight must have the occupancy's shape {list(occupancy.shape)}, got "
                f"{list(weight.shape)}."
            )
        check_real("weight", weight)
        if weight.numel():
            least, most = (float(value) for value in weight.detach().aminmax())  # NaN if one is
            if not 0 < least <= most < math.inf:
                raise ValueError(
                    f"AStar: weight must be > 0 and finite, got values from {least} to {most}."
                )
        weights = weight.detach().float().cpu().contiguous().numpy()
        return self._plan(occupancy, start, goal, weights)

    def _run(
        self,
        maps: Maps,
        queries: Queries,
        paths: PathArrays,
        weight: NDArray[Any] = _SAME_EVERYWHERE,
    ) -> None:
        batch = len(queries.cells)
        plan_all(batch, maps, queries, paths, weight, self.neighbours)
