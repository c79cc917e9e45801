"""`Paths`, the result of a planner, and points on paths."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from modpush._checks import check_dtype, check_finite, check_real, check_shape
from modpush._kernels import sum_in_order
from modpush._types import Positive
from modpush._validation import check_value

_NEAR = 2.0
"""Tolerance of a path's ends along each axis [px], since planners round."""
_LENGTH_TOLERANCE = 0.01
"""Tolerance of a path's length beside `_NEAR`, as a fraction of it."""
_DTYPES = {
    "count": torch.int64,
    "length": torch.float32,
    "found": torch.bool,
    "start_moved": torch.bool,
    "goal_moved": torch.bool,
}


@dataclass(frozen=True, kw_only=True)
class Paths:
    """One planned path for each of B scenes, in the pixel frame.

    The pixel frame has (u, v) = (column, row) and cell centres at integers. A path joins exactly the
    requested start and goal. If an end lies outside the grid or in a blocked cell, the path's first or
    last leg joins it to the nearest free cell's centre; only that leg may cross blocked cells, and
    `start_moved` or `goal_moved` is True.

    Attributes:
        waypoints: `[B, P, 2]` float32 [px], start first, padded with the goal; where no path was found,
            the start alone.
        count: `[B]` int64, number of the path's waypoints, at least 2; 0 where none was found.
        length: `[B]` float32, [px] times the planner's `cell_size`; inf where none was found.
        found: `[B]` bool, a path was found.
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
        """Make `Paths` from lists of waypoints, for a user-defined planner.

        Args:
            paths: For each scene its waypoints `[P_b, 2]` [px], P_b >= 2, or None if there is no path.
            start: `[B, 2]` [px], the waypoints where there is no path.
            cell_size: The planner's attribute `cell_size`, which lengths are multiplied with; 1, for
                lengths in pixels, if it has none.

        Raises:
            TypeError: If a path is not a tensor.
            ValueError: If a shape differs from the expected one, or `cell_size` is not positive.
        """
        check_value("cell_size", cell_size, Positive)
        check_real("start", start, 2)
        check_finite("start", start)
        if start.ndim != 2:
            raise ValueError(f"start must be [B, 2], got {list(start.shape)}.")
        if not isinstance(paths, Sequence) or len(paths) != len(start):
            raise ValueError(
                f"paths must be a sequence of {len(start)}, one for each start, got {paths!r}."
            )
        for path in paths:
            if path is not None:
                check_real("paths", path, 2)
                if path.ndim != 2 or len(path) < 2:
                    raise ValueError(
                        f"each of the paths must be [P >= 2, 2], got {list(path.shape)}."
                    )
        longest = max([2, *(len(path) for path in paths if path is not None)])
        waypoints = start[:, None].repeat(1, longest, 1).float()
        count = torch.zeros(len(paths), dtype=torch.int64, device=start.device)
        length = torch.full((len(paths),), torch.inf, dtype=torch.float32, device=start.device)
        for b, path in enumerate(paths):
            if path is not None:
                count[b] = len(path)
                waypoints[b, : len(path)] = path
                waypoints[b, len(path) :] = path[-1]
                length[b] = (path[1:] - path[:-1]).float().norm(dim=-1).sum() * cell_size
        moved = torch.zeros(len(paths), dtype=torch.bool, device=start.device)
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


def check_paths(
    paths: Any,
    batch: int,
    start: Tensor | None = None,
    goal: Tensor | None = None,
    cell_size: float | None = None,
) -> Paths:
    """Check the result of a planner.

    Args:
        paths: The result.
        batch: Expected number of scenes.
        start: Requested starts, `[B, 2]` (u, v) [px]; None to leave them unchecked.
        goal: Requested goals, the same.
        cell_size: The planner's, which lengths are compared with; None to leave them unchecked.

    Raises:
        TypeError: If it is not a `Paths`, or a field has another dtype.
        ValueError: If a field has another shape, a waypoint or the length of a path that was found is
            not finite, such a path begins or ends elsewhere although its end is not marked as moved, or
            its length is not that of its waypoints.
    """
    if not isinstance(paths, Paths):
        raise TypeError(f"plan must return modpush.planners.Paths, got {type(paths)}.")
    check_dtype("waypoints", paths.waypoints, torch.float32)
    shape = paths.waypoints.shape
    if len(shape) != 3 or shape[0] != batch or shape[1] < 2 or shape[2] != 2:
        raise ValueError(f"waypoints must be [B, P, 2] = [{batch}, P >= 2, 2], got {list(shape)}.")
    for name, dtype in _DTYPES.items():
        value = getattr(paths, name)
        check_dtype(name, value, dtype)
        check_shape(name, value, "B", (batch,))
    if not paths.waypoints.isfinite().all():
        raise ValueError("a waypoint is not finite; fill up with the path's last point.")
    if not paths.length[paths.found].isfinite().all():
        raise ValueError("the length of a path that was found is not finite.")
    for name, end, asked, moved in (
        ("begin", 0, start, paths.start_moved),
        ("end", -1, goal, paths.goal_moved),
    ):
        if asked is None:
            continue
        given = paths.waypoints[:, end]
        wrong = paths.found & ~moved & ((given - asked).abs().amax(-1) > _NEAR)
        if wrong.any():
            b = int(wrong.nonzero()[0])
            raise ValueError(
                f"the path of scene {b} must {name} at (u, v) = {asked[b].tolist()} px, got "
                f"{given[b].tolist()}; are u, along a row, and v exchanged, or is it reversed?"
            )
    if cell_size is not None:
        legs = (paths.waypoints[:, 1:] - paths.waypoints[:, :-1]).norm(dim=-1).sum(-1)
        away = (paths.length / cell_size - legs).abs()
        wrong = paths.found & (away > _NEAR + _LENGTH_TOLERANCE * legs)
        if wrong.any():
            b = int(wrong.nonzero()[0])
            raise ValueError(
                f"the length of scene {b}'s path must be that of its waypoints, {legs[b]:.4g} px, times "
                f"the planner's cell_size {cell_size:g}, got {paths.length[b]:.4g}; pass the planner's "
                "cell_size, 1 if it has none, to Paths.from_waypoints."
            )
    return paths


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
