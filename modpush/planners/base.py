"""The planners' common interface: a map, a start and a goal in, paths out."""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from modpush._checks import check_dtype
from modpush.planners.kernels.visibility import MAX_SIDE


@dataclass(frozen=True, kw_only=True)
class Paths:
    """One planned path for each of B scenes, in the pixel frame.

    The pixel frame has (u, v) = (column, row) and cell centres at integers. A path runs from the
    start to the goal exactly as they were asked for. If an end lay outside the grid or in a
    blocked cell, the path's first or last leg joins it to the nearest free cell's centre; that leg
    alone may cross blocked cells, and `start_moved` or `goal_moved` says so.

    Attributes:
        waypoints: `[B, P, 2]` float32 [px], start first; past a path's end the goal is repeated.
            Where no path was found, the start alone.
        count: `[B]` int64, how many waypoints belong to the path, at least 2; 0 where none was
            found.
        length: `[B]` float32, [px] times the planner's `cell_size`; inf where none was found.
        found: `[B]` bool.
        start_moved: `[B]` bool, the start was not free.
        goal_moved: `[B]` bool, the goal was not free.
    """

    waypoints: Tensor
    count: Tensor
    length: Tensor
    found: Tensor
    start_moved: Tensor
    goal_moved: Tensor

    @classmethod
    def from_waypoints(
        cls, paths: Sequence[Tensor | None], start: Tensor, cell_size: float = 1.0
    ) -> "Paths":
        """Pack paths of different lengths: what a planner of your own needs to return.

        Args:
            paths: For each scene its waypoints `[P_b, 2]` [px], P_b >= 2, or None if there is none.
            start: `[B, 2]` [px], fills in where there is no path.
            cell_size: Metres a pixel, or 1 for lengths in pixels.
        """
        longest = max([2, *(len(path) for path in paths if path is not None)])
        waypoints = start[:, None].repeat(1, longest, 1).float()
        count = torch.zeros(len(paths), dtype=torch.int64)
        length = torch.full((len(paths),), torch.inf)
        for b, path in enumerate(paths):
            if path is not None:
                count[b] = len(path)
                waypoints[b, : len(path)] = path
                waypoints[b, len(path) :] = path[-1]
                length[b] = (path[1:] - path[:-1]).norm(dim=-1).sum() * cell_size
        moved = torch.zeros(len(paths), dtype=torch.bool)
        return cls(
            waypoints=waypoints,
            count=count,
            length=length,
            found=count > 0,
            start_moved=moved,
            goal_moved=moved.clone(),
        )

    def to(self, device: torch.device) -> "Paths":
        """The same paths on another device."""
        return Paths(**{name: value.to(device) for name, value in vars(self).items()})


def point_along(waypoints: Tensor, distance: Tensor) -> Tensor:
    """The point that lies a given way along a polyline.

    Args:
        waypoints: `[B, P, 2]`, P >= 2; padded by repeating the last point.
        distance: `[B]`, in the waypoints' unit; below 0 gives the first point, past the end the
            last one.

    Returns:
        `[B, 2]`.
    """
    steps = waypoints[:, 1:] - waypoints[:, :-1]  # [B, P-1, 2]
    lengths = steps.norm(dim=-1)
    ends = lengths.cumsum(-1)
    distance = torch.minimum(distance.clamp_min(0.0), ends[:, -1])[:, None]
    segment = torch.searchsorted(ends, distance).clamp_max(lengths.shape[1] - 1)  # [B, 1]
    length = lengths.gather(1, segment)
    # A segment without length is reached only where the whole path has none.
    ratio = (distance - ends.gather(1, segment) + length) / length.clamp_min(1e-12)
    index = segment[..., None].expand(-1, -1, 2)
    point = waypoints.gather(1, index) + ratio.clamp(0.0, 1.0)[..., None] * steps.gather(1, index)
    return point.squeeze(1)


class Planner(ABC):
    """Implement `_plan`: paths for a batch of maps. Subclasses work on the CPU.

    Args:
        cell_size: Metres a pixel; lengths are given in pixels times this.

    Raises:
        ValueError: If `cell_size` is not positive.
    """

    def __init__(self, cell_size: float = 1.0) -> None:
        if not (cell_size > 0 and math.isfinite(cell_size)):
            raise ValueError(
                f"{type(self).__name__}: cell_size must be > 0 and finite, got {cell_size}."
            )
        self.cell_size = float(cell_size)

    def plan(self, occupancy: Tensor, start: Tensor, goal: Tensor) -> Paths:
        """Plan one path a scene.

        Args:
            occupancy: `[B, H, W]` bool, True where blocked; H and W from 1 to 4096.
            start: `[B, 2]` float (u, v) [px]; anywhere, see `Paths` for ends that are not free.
            goal: `[B, 2]` float (u, v) [px].

        Returns:
            The paths, on the occupancy's device.

        Raises:
            TypeError: If the occupancy is not bool, or an end is not floating point.
            ValueError: If shapes do not fit each other, or an end is not finite.
        """
        return self._plan_checked(occupancy, start, goal)

    def _plan_checked(self, occupancy: Tensor, start: Tensor, goal: Tensor, *options: Any) -> Paths:
        """Check and convert the arguments of `plan`, then call `_plan` with the options as well."""
        name = type(self).__name__
        check_dtype(name, "occupancy", occupancy, torch.bool)
        if occupancy.ndim != 3 or not all(1 <= side <= MAX_SIDE for side in occupancy.shape[1:]):
            raise ValueError(
                f"{name}: occupancy must be [B, H, W] with H and W from 1 to {MAX_SIDE}, got "
                f"{list(occupancy.shape)}."
            )
        ends = [self._check_end("start", start, len(occupancy))]
        ends.append(self._check_end("goal", goal, len(occupancy)))
        if occupancy.device.type == "cpu":
            return self._plan(occupancy.contiguous(), *ends, *options)
        return self._plan(occupancy.cpu().contiguous(), *ends, *options).to(occupancy.device)

    def _check_end(self, what: str, point: Tensor, batch: int) -> Tensor:
        name = type(self).__name__
        if not (isinstance(point, Tensor) and point.is_floating_point()):
            got = point.dtype if isinstance(point, Tensor) else type(point).__name__
            raise TypeError(f"{name}: {what} must be a floating point tensor, got {got}.")
        if point.shape != (batch, 2):
            raise ValueError(
                f"{name}: {what} must be [B, 2] = [{batch}, 2], got {list(point.shape)}."
            )
        point = point.detach().to("cpu", torch.float32).contiguous()
        finite = np.isfinite(point.numpy())  # several times faster than torch on so few numbers
        if not finite.all():
            scenes = (~finite).any(-1).nonzero()[0].tolist()
            raise ValueError(f"{name}: {what} is not finite in scene(s) {scenes}.")
        return point

    def warmup(self, height: int = 256, width: int = 256) -> None:
        """Compile (or load from the cache on disk) all that planning needs, once, ahead of use.

        Args:
            height: Grid height; no matter for what is compiled, memory is laid out for it.
            width: Grid width.
        """
        for batch in (1, 2):  # one scene and several run through different kernels
            occupancy = torch.zeros(batch, height, width, dtype=torch.bool)
            occupancy[:, height // 2, : width // 2 + 1] = True
            start = torch.zeros(batch, 2)
            goal = torch.tensor([[0.0, height - 1.0]]).repeat(batch, 1)
            self.plan(occupancy, start, goal)

    @abstractmethod
    def _plan(self, occupancy: Tensor, start: Tensor, goal: Tensor) -> Paths:
        """Plan for checked, contiguous CPU tensors: bool `[B, H, W]`, float32 `[B, 2]` twice."""
