"""Points on paths."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from modpush._batching import sum_in_order
from modpush._checks import check_finite, check_real
from modpush.planners.paths import Paths

__all__ = ["fraction_subgoal", "lookahead_subgoal", "point_along", "points_ahead"]


def point_along(waypoints: Tensor, distance: Tensor) -> Tensor:
    """The point at a distance along a polyline.

    Args:
        waypoints: `[B, P, 2]`, P >= 2; padded by repeating the last point.
        distance: `[B]`, in the waypoints' unit; below 0 gives the first point, past the end the
            last one.

    Returns:
        `[B, 2]`.

    Raises:
        TypeError: If an argument is not a tensor of real numbers.
        ValueError: If a shape differs from the expected one, a waypoint is not finite, or a distance is
            NaN.
    """
    check_real("waypoints", waypoints, 2)
    check_real("distance", distance)
    if waypoints.ndim != 3 or waypoints.shape[1] < 2 or distance.shape != waypoints.shape[:1]:
        raise ValueError(
            f"point_along: waypoints must be [B, P >= 2, 2] and distance [B], got "
            f"{list(waypoints.shape)} and {list(distance.shape)}."
        )
    check_finite("waypoints", waypoints)
    if distance.isnan().any():
        raise ValueError(f"point_along: distance must be a number, got {distance.tolist()}.")
    return _point_along(waypoints, distance)


def _point_along(waypoints: Tensor, distance: Tensor) -> Tensor:
    """`point_along` of checked arguments."""
    if not waypoints.is_floating_point():
        waypoints = waypoints.float()
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


def fraction_subgoal(paths: Paths, fraction: float) -> Tensor:
    """The point at a fraction of each path's length.

    Args:
        paths: Paths of B scenes.
        fraction: In [0, 1].

    Returns:
        `[B, 2]` [px].

    Raises:
        ValueError: If the fraction is not in [0, 1].
    Source: Sec. IV-B of the paper, 20 % of the global path.
    """
    if not 0 <= fraction <= 1:
        raise ValueError(f"fraction_subgoal: fraction must be in [0, 1], got {fraction}.")
    legs = (paths.waypoints[:, 1:] - paths.waypoints[:, :-1]).norm(dim=-1)
    return _point_along(paths.waypoints, fraction * sum_in_order(legs))


def lookahead_subgoal(paths: Paths, distance: float) -> Tensor:
    """The point at a distance along each path, but not beyond its first corner.

    Args:
        paths: Paths of B scenes. If a start was moved, the leg to free space is not the first segment.
        distance: [px].

    Returns:
        `[B, 2]` [px].

    Raises:
        ValueError: If the distance is negative or not finite.
    Source: The authors' code, in place of the fraction.
    """
    if not 0 <= distance < math.inf:
        raise ValueError(f"lookahead_subgoal: distance must be finite and >= 0, got {distance}.")
    legs = (paths.waypoints[:, 1:] - paths.waypoints[:, :-1]).norm(dim=-1)  # [B, P-1]
    first = legs[:, 0]
    if legs.shape[1] > 1:
        first = torch.where(paths.start_moved, first + legs[:, 1], first)
    return _point_along(paths.waypoints, first.clamp_max(distance))


def points_ahead(paths: Paths, distances: Sequence[float]) -> Tensor:
    """Points at several distances along each path; beyond its end, the end.

    Unlike `lookahead_subgoal` they also lie beyond corners, so that they show where the path turns.

    Args:
        paths: Paths of B scenes.
        distances: n distances [px].

    Returns:
        `[B, n, 2]` [px].

    Raises:
        ValueError: If a distance is negative or not finite.
    """
    if not all(0 <= distance < math.inf for distance in distances):
        raise ValueError(f"points_ahead: distances must be finite and >= 0, got {distances}.")
    count = len(distances)
    waypoints = paths.waypoints.repeat_interleave(count, 0)  # [B * n, P, 2]
    along = waypoints.new_tensor(distances).repeat(len(paths.waypoints))
    return _point_along(waypoints, along).reshape(len(paths.waypoints), count, 2)
