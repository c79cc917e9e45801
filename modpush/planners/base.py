"""The planners' common interface: a map, a start and a goal in, paths out."""

from abc import ABC, abstractmethod

from torch import Tensor

from modpush._types import Positive
from modpush._validation import checked_arguments
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
