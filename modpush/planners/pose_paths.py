"""`PosePaths`, points on them, and the poses and extents on which `PoseField` searches."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
import torch
from annotated_types import Ge
from numpy.typing import NDArray
from torch import Tensor

from modpush._checks import check_real
from modpush._validation import checked_arguments
from modpush.geometry.camera import Camera
from modpush.planners.kernels.footprint_poses import PoseGrid
from modpush.planners.occupancy import Corners
from modpush.planners.occupancy_map import radius_per_scene


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


class Turns(NamedTuple):
    """Number of yaws, yaw between two of them [rad] and turning radius [m] of each scene, `[B]`."""

    layers: NDArray[np.int64]
    step: NDArray[np.float64]
    radius: NDArray[np.float64]


def make_turns(
    yaws: int,
    turning_radius: float | None,
    extents: NDArray[np.float64],
    symmetry: float | Tensor,
) -> Turns:
    """The yaws that are searched: `yaws` in a full circle, for footprints of extents `[B, N]` [m].

    The cost of turning is `turning_radius` [m/rad], None for the greatest extent. `symmetry` is the
    number of yaw angles at which the object looks the same, one number or `[B]`, 0 for any number.
    """
    order = radius_per_scene(symmetry, len(extents), "symmetry")
    if (order != np.rint(order)).any():
        raise ValueError(f"symmetry must be a whole number >= 0, got {order.tolist()}.")
    layers = np.ceil(yaws / np.maximum(order, 1.0)).astype(np.int64)
    layers[order == 0] = 1
    step = 2.0 * np.pi / (np.maximum(order, 1.0) * layers)
    radius = np.full(len(extents), turning_radius or 0.0)
    if turning_radius is None:
        radius = extents.max(1)
    return Turns(layers, step, radius)


def make_grid(camera: Camera, stride: int, bounds: Corners | None) -> PoseGrid:
    """The positions within bounds and image, in the middle of both."""
    low, high = np.zeros(2), np.array([camera.width - 1.0, camera.height - 1.0])
    if bounds is not None:
        pixels = camera.project(np.array(bounds, dtype=np.float64))
        # x points up in the image, and y to the left.
        low = np.maximum(low, np.ceil(pixels[1]))
        high = np.minimum(high, np.floor(pixels[0]))
    if not (low <= high).all():
        raise ValueError(f"PoseField: bounds must leave a position in the image, got {bounds!r}.")
    counts = ((high - low) // stride).astype(int) + 1
    first = (low + (high - low - stride * (counts - 1)) // 2).astype(int)
    return PoseGrid(
        first_u=int(first[0]),
        first_v=int(first[1]),
        stride=stride,
        rows=int(counts[1]),
        columns=int(counts[0]),
    )


@checked_arguments
def polygon_support(corners: Tensor, directions: Annotated[int, Ge(3)] = 48) -> Tensor:
    """Extent of a polygon from the origin in directions at equal angles, the first along x.

    Args:
        corners: `[..., P, 2]` (x, y) in the object's frame, in any order [m]. A footprint that is not
            convex is given the extents of its hull.
        directions: Number of directions N. A side that faces none of them is moved outwards.

    Returns:
        `[..., N]` [m].

    Raises:
        TypeError: If `corners` is not a tensor of real numbers.
        ValueError: If its last dimension is not 2, or it has no corner.
    """
    check_real("corners", corners, 2)
    if corners.ndim < 2 or not corners.shape[-2]:
        raise ValueError(f"corners must be [..., P >= 1, 2], got {list(corners.shape)}.")
    angle = 2.0 * math.pi / directions * torch.arange(directions)
    axes = torch.stack([angle.cos(), angle.sin()]).to(corners)
    return (corners @ axes).amax(-2)


def extents_per_scene(support: Tensor, batch: int) -> NDArray[np.float64]:
    """Extents of the footprints, `[B, N]` float64, all positive and finite."""
    check_real("support", support)
    if support.ndim != 2 or len(support) != batch or support.shape[1] < 3:
        raise ValueError(
            f"support must be [B, N >= 3] with B = {batch}, got {list(support.shape)}."
        )
    extents = support.detach().double().cpu().numpy()
    good = np.isfinite(extents) & (extents > 0.0)
    if not good.all():
        scene = int((~good).any(1).nonzero()[0][0])
        raise ValueError(
            f"support must be positive and finite [m], got {extents[scene].min():g} to "
            f"{extents[scene].max():g} in scene {scene}."
        )
    return extents
