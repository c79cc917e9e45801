"""`PosePaths`: paths of poses (x, y, yaw), and points on them."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from modpush._checks import check_real


@dataclass(frozen=True, kw_only=True)
class PosePaths:
    """One planned path of poses for each of B scenes, in the robot's base frame.

    Between waypoints the pose changes linearly. The yaw is continuous from the start's, not wrapped: the
    last waypoint is the goal with the equivalent yaw to which the object is turned.

    A path joins exactly the requested start and goal. If an end is not free or lies outside the
    planner's grid, the path's first or last leg joins it to the nearest free pose; only that leg may
    cross obstacles, and `start_moved` or `goal_moved` is True.

    Attributes:
        waypoints: `[B, P, 3]` float32 (x, y, yaw) [m, rad], start first, padded with the goal; where no
            path was found, the start alone.
        along: `[B, P]` float32, the path's cost from the start to each waypoint [m], padded with the
            last: metres of way, and radians of turning times the turning radius.
        count: `[B]` int64, number of the path's waypoints, at least 2; 0 where none was found.
        length: `[B]` float32, the whole path's cost [m]; inf where none was found.
        found: `[B]` bool, a path was found.
        start_moved: `[B]` bool, the start was not free.
        goal_moved: `[B]` bool, the goal was not free.
    """

    waypoints: Tensor
    along: Tensor
    count: Tensor
    length: Tensor
    found: Tensor
    start_moved: Tensor
    goal_moved: Tensor


def poses_along(paths: PosePaths, distances: Tensor | Sequence[float]) -> Tensor:
    """Poses at distances along each path, measured by its cost.

    Args:
        paths: Paths of B scenes.
        distances: `[n]` or `[B, n]` [m]; below 0 gives the start, past the end the goal.

    Returns:
        `[B, n, 3]` float32 (x, y, yaw) [m, rad]; the start where no path was found.

    Raises:
        TypeError: If the distances are not real numbers.
        ValueError: If they do not have one of these shapes, or one is NaN.
    """
    along = paths.along
    if not isinstance(distances, Tensor):
        distances = along.new_tensor(distances)
    check_real("distances", distances)
    if distances.ndim not in (1, 2) or (distances.ndim == 2 and len(distances) != len(along)):
        raise ValueError(
            f"poses_along: distances must be [n] or [B, n] with B = {len(along)}, got "
            f"{list(distances.shape)}."
        )
    if distances.isnan().any():
        raise ValueError(f"poses_along: distances must be numbers, got {distances.tolist()}.")
    wanted = distances.to(along).expand(len(along), -1).contiguous()
    after = torch.searchsorted(along, wanted).clamp(1, along.shape[1] - 1)  # [B, n]
    first, last = along.gather(1, after - 1), along.gather(1, after)
    ratio = ((wanted - first) / (last - first).clamp_min(1e-12)).clamp(0.0, 1.0)
    index = after[..., None].expand(-1, -1, 3)
    return torch.lerp(
        paths.waypoints.gather(1, index - 1), paths.waypoints.gather(1, index), ratio[..., None]
    )
