"""Points on paths."""

import torch
from torch import Tensor

from modpush._checks import check_instance, check_width
from modpush._types import Fraction, NonNegative
from modpush._validation import check_value
from modpush.planners.paths import Paths

__all__ = ["fraction_subgoal", "lookahead_subgoal", "point_along"]


def point_along(waypoints: Tensor, distance: Tensor) -> Tensor:
    """The point that lies a given way along a polyline.

    Args:
        waypoints: `[B, P, 2]`, P >= 2; padded by repeating the last point.
        distance: `[B]`, in the waypoints' unit; below 0 gives the first point, past the end the
            last one.

    Returns:
        `[B, 2]`.

    Raises:
        TypeError: If one of them is no tensor of real numbers.
        ValueError: If a shape is another one.
    """
    check_width("point_along", "waypoints", waypoints, 2)
    check_width("point_along", "distance", distance, len(waypoints))
    if waypoints.ndim != 3 or waypoints.shape[1] < 2 or distance.ndim != 1:
        raise ValueError(
            f"point_along: waypoints must be [B, P >= 2, 2] and distance [B], got "
            f"{list(waypoints.shape)} and {list(distance.shape)}."
        )
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
    """The point after a fraction of each path's length.

    Args:
        paths: Of B scenes.
        fraction: In [0, 1].

    Returns:
        `[B, 2]` [px].

    Raises:
        TypeError: If `paths` are none.
        ValueError: If the fraction is not in [0, 1].
    Source: Sec. IV-B of the paper, 20 % of the global path.
    """
    check_instance("fraction_subgoal", "paths", paths, Paths)
    check_value("fraction_subgoal", "fraction", fraction, Fraction)
    lengths = (paths.waypoints[:, 1:] - paths.waypoints[:, :-1]).norm(dim=-1).sum(-1)
    return point_along(paths.waypoints, fraction * lengths)


def lookahead_subgoal(paths: Paths, distance: float) -> Tensor:
    """The point a distance along each path, but not past its first corner.

    Args:
        paths: Of B scenes. If a start was moved, the leg out to free space does not count as the
            first segment.
        distance: [px].

    Returns:
        `[B, 2]` [px].

    Raises:
        TypeError: If `paths` are none.
        ValueError: If the distance is negative or not finite.
    Source: what the authors' code does in place of the fraction.
    """
    check_instance("lookahead_subgoal", "paths", paths, Paths)
    check_value("lookahead_subgoal", "distance", distance, NonNegative)
    legs = (paths.waypoints[:, 1:] - paths.waypoints[:, :-1]).norm(dim=-1)  # [B, P-1]
    first = legs[:, 0]
    if legs.shape[1] > 1:
        first = torch.where(paths.start_moved, first + legs[:, 1], first)
    return point_along(paths.waypoints, first.clamp_max(distance))
