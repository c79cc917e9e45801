"""The point that the object is pushed towards: a visible point of the path, with room for the tool.

Source: Krivic and Piater (2019), as implemented by the paper's authors: the relaxed look-ahead with its
fallbacks. `turn_target` is not part of their code: their rod may graze obstacles, but a gripper stalls
at the obstacles that the object has to pass.
"""

from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict
from torch import Tensor

from modpush._kernels import njit
from modpush.agents.corridor.config import CorridorConfig
from modpush.agents.corridor.scene import CorridorScene, least_clearance

CHECKED_AHEAD = 0.05
"""Distance ahead of the object that must be free for a turned target [m]."""


class View(NamedTuple):
    """One scene on the grid; positions are `[2]` (u, v) [px]."""

    distance: NDArray[Any]  # Distance of each cell to obstacles, `[H, W]` float32 [cells]
    path: NDArray[Any]  # Path of the object, `[N, 2]` (u, v) [px], the goal last
    position: NDArray[Any]  # Position of the object
    tool: NDArray[Any]  # Position of the tool
    previous: NDArray[Any]  # Target of the step before
    first: bool  # First step of an episode, without a previous target


class Limits(NamedTuple):
    """Distances that object and tool keep from obstacles."""

    # Width of the outer zone, in which the tool behind the object may touch the obstacle [cells]
    outer: float
    inner: float  # Width of the inner zone, in which the object may touch the obstacle [cells]
    touch: float  # Distance at which the object touches an obstacle [cells]
    tool: float  # Clearance of the tool's centre from obstacles [cells]
    behind: float  # Distance behind the object from which the tool pushes it [px]
    # Limits for an object that is closer to an obstacle: True shrinks them to its present distance
    # and requires room behind it; False leaves no visible point until the object is out
    relative: bool
    path_step: int  # Lead of the last fallback's target over the object, in points of the path


@njit(nogil=True)
def _pushing_position(view: View, point: NDArray[Any], behind: float) -> tuple[float, float]:
    """Position from which the tool pushes the object towards a point, (u, v) [px]."""
    du, dv = view.position[0] - point[0], view.position[1] - point[1]
    length = max(np.sqrt(du * du + dv * dv), 1e-9)
    return view.position[0] + du / length * behind, view.position[1] + dv / length * behind


@njit(nogil=True)
def _has_room_behind(view: View, point: NDArray[Any], behind: float, clearance: float) -> bool:
    """True if the pushing position has more than `clearance` [cells]."""
    u, v = _pushing_position(view, point, behind)
    return least_clearance(view.distance, u, v, u, v) > clearance


@njit(nogil=True)
def _tool_can_reach(view: View, point: NDArray[Any], limits: Limits) -> bool:
    """True if the straight line from the tool to the pushing position is clear."""
    u, v = _pushing_position(view, point, limits.behind)
    return least_clearance(view.distance, u, v, view.tool[0], view.tool[1]) > limits.tool


@njit(nogil=True)
def _furthest_visible(
    view: View, limits: Limits, nearest: int, near_obstacle: bool
) -> tuple[int, int, int]:
    """Indices of the furthest visible points clear of the outer zone, the inner zone, and obstacles.

    Every second point is tested, from the goal back to the nearest one; -1 stands for none.
    """
    position, last = view.position, view.path.shape[0] - 1
    tight, touching = -1, -1
    for k in range(last, nearest - 1, -2):
        point = view.path[k]
        if (point[0] - position[0]) ** 2 + (point[1] - position[1]) ** 2 < 1.0 and k < last:
            continue  # no direction to push in
        if view.first and not _has_room_behind(view, point, limits.behind, 0.0):
            continue
        clear = least_clearance(view.distance, position[0], position[1], point[0], point[1])
        if clear <= limits.touch:
            continue
        # Near an obstacle a clear line ahead does not imply room behind the object.
        if near_obstacle and not _has_room_behind(view, point, limits.behind, limits.tool):
            continue
        if touching < 0:
            touching = k
        if clear > limits.inner and tight < 0:
            tight = k
        if clear > limits.outer:
            return k, tight, touching  # clear of the outer zone is clear of the others
    return -1, tight, touching


@njit(nogil=True)
def _fallback(view: View, limits: Limits, nearest: int, visible: tuple[int, int, int]) -> int:
    """Index of the target's point where none is clear of the outer zone, -1 for the target before."""
    _, tight, touching = visible
    for k in visible:
        if k >= 0 and _tool_can_reach(view, view.path[k], limits):
            return k
    ahead = min(nearest + limits.path_step, view.path.shape[0] - 1)
    u, v = view.path[nearest, 0], view.path[nearest, 1]
    path_is_clear = least_clearance(view.distance, u, v, u, v) > limits.outer
    if path_is_clear and _tool_can_reach(view, view.path[nearest], limits):
        return ahead
    if tight >= 0:
        return tight
    if limits.relative:
        return touching if touching >= 0 else ahead
    return -1


@njit(nogil=True)
def look_ahead(view: View, limits: Limits) -> tuple[float, float]:
    """Target on the path, (u, v) [px].

    It is the furthest point to which the object's straight line is clear of the outer zone. If there is
    none, the following are tried in this order: the furthest point clear of the inner zone, then of
    obstacles, whose pushing position the tool reaches on a straight line; the point `path_step` ahead,
    if the path is clear there; the furthest point clear of the inner zone; the target before.
    """
    position, near_obstacle = view.position, False
    if limits.relative:
        u, v = position[0], position[1]
        here = least_clearance(view.distance, u, v, u, v) - 1.0
        near_obstacle = here < limits.outer
        limits = Limits(
            min(limits.outer, here),
            min(limits.inner, here),
            min(limits.touch, here),
            limits.tool,
            limits.behind,
            limits.relative,
            limits.path_step,
        )
    nearest = ((view.path - position) ** 2).sum(1).argmin()
    visible = _furthest_visible(view, limits, nearest, near_obstacle)
    k = visible[0]
    if k < 0 or near_obstacle:
        k = _fallback(view, limits, nearest, visible)
    if k < 0 and view.first:
        k = min(nearest + limits.path_step, view.path.shape[0] - 1)
    if k < 0:
        return view.previous[0], view.previous[1]
    return view.path[k, 0], view.path[k, 1]


@njit(nogil=True)
def turn_target(
    distance: NDArray[Any],
    position: NDArray[Any],
    target: NDArray[Any],
    behind: float,
    tool: float,
    ahead: float,
    touch: float,
) -> tuple[float, float]:
    """Turn the target around the object until the tool has room behind it, (u, v) [px].

    An object beside a wall cannot be pushed straight off it; it can be pushed along it and a little
    outwards. The smallest turn of at most 105 degrees to either side is taken, none if no turn makes
    room: with `tool` cells of clearance at the distance `behind` the object [px], and `touch`, or what
    there is, on the next `ahead` pixels before it. `distance` `[H, W]` is that of each cell to obstacles
    [cells].
    """
    du, dv = target[0] - position[0], target[1] - position[1]
    length = max(np.sqrt(du * du + dv * dv), 1e-9)
    here = least_clearance(distance, position[0], position[1], position[0], position[1])
    reach = min(ahead, length) / length
    for k in range(15):
        angle = ((k + 1) // 2) * np.radians(15.0) * (1 if k % 2 else -1)
        c, s = np.cos(angle), np.sin(angle)
        tu, tv = c * du - s * dv, s * du + c * dv
        bu, bv = position[0] - tu / length * behind, position[1] - tv / length * behind
        if least_clearance(distance, bu, bv, bu, bv) < tool:
            continue
        fu, fv = position[0] + tu * reach, position[1] + tv * reach
        clear = least_clearance(distance, position[0], position[1], fu, fv)
        if clear >= min(touch, here - 1.0):
            return position[0] + tu, position[1] + tv
    return target[0], target[1]


def choose_targets(scene: CorridorScene, state: TensorDict, config: CorridorConfig) -> Tensor:
    """Target of each scene's look-ahead, turned where the tool has no room, `[B, 2]` (x, y) [m]."""
    camera, cell = scene.camera, scene.camera.cell_size
    path, position, tool, previous = (
        camera.project(value.double()).numpy()
        for value in (state["path"], scene.object_position, scene.tool_position, state["target"])
    )
    first = (~state["started"].squeeze(-1)).tolist()
    touch = torch.minimum(config.touch_zone * scene.object_radius, scene.touch_radius) / cell
    targets = []
    for b, radius in enumerate((scene.object_radius / cell).tolist()):
        limits = Limits(
            outer=config.outer_zone * radius,
            inner=config.inner_zone * radius,
            touch=float(touch[b]),
            tool=config.tool_clearance / cell,
            behind=config.behind_distance / cell,
            relative=config.rules == "mended",
            path_step=config.path_step,
        )
        distance = scene.obstacle_distance[b]
        view = View(distance, path[b], position[b], tool[b], previous[b], first[b])
        targets.append(look_ahead(view, limits))
    target = _to_metres(targets, scene)
    return target if config.contact_distance == 0 else _turn_targets(scene, target, config)


def _turn_targets(scene: CorridorScene, target: Tensor, config: CorridorConfig) -> Tensor:
    """Targets `[B, 2]` [m] after `turn_target`."""
    camera, cell = scene.camera, scene.camera.cell_size
    positions = camera.project(scene.object_position.double()).numpy()
    targets = camera.project(target.double()).numpy()
    touch = torch.minimum(scene.object_radius, scene.touch_radius) / cell
    tool, ahead = config.tool_clearance / cell, CHECKED_AHEAD / cell
    turned = []
    for b, radius in enumerate(scene.object_radius.tolist()):
        room = (radius + config.contact_distance) / cell, tool, ahead, float(touch[b])
        distance = scene.obstacle_distance[b]
        turned.append(turn_target(distance, positions[b], targets[b], *room))
    return _to_metres(turned, scene)


def _to_metres(pixels: list[tuple[float, float]], scene: CorridorScene) -> Tensor:
    """Pixels (u, v) as positions `[B, 2]` (x, y) [m]."""
    position = scene.camera.unproject(torch.tensor(pixels, dtype=torch.float64))
    return position.to(scene.object_position.dtype)
