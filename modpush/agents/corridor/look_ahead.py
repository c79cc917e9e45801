"""The point of the path that the object is pushed towards.

Source: Krivic and Piater (2019), in the form of the code that the paper compares with: the relaxed
look-ahead with its fallbacks.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from modpush._kernels import njit
from modpush.agents.corridor.clearance import least_clearance


class View(NamedTuple):
    """One scene on the grid."""

    distance: NDArray[Any]
    """Distance of each cell to obstacles, `[H, W]` float32 [cells]."""
    path: NDArray[Any]
    """Path of the object, `[N, 2]` (u, v) [px], the goal last."""
    position: NDArray[Any]
    """Position of the object, `[2]` (u, v) [px]."""
    tool: NDArray[Any]
    """Position of the tool, `[2]` (u, v) [px]."""
    previous: NDArray[Any]
    """The target before, `[2]` (u, v) [px]."""
    first: bool
    """Whether there was no target before."""


class Limits(NamedTuple):
    """Distances that object and tool keep from obstacles."""

    outer: float
    """Width of the outer zone: closer to an obstacle, the tool behind the object may touch it [cells]."""
    inner: float
    """Width of the inner zone: closer to an obstacle, the object may touch it [cells]."""
    touch: float
    """Distance at which the object touches an obstacle [cells]."""
    tool: float
    """Distance that the tool's centre keeps from obstacles [cells]."""
    behind: float
    """Distance behind the object at which the tool pushes it [px]."""
    relative: bool
    """Whether an object that is closer to an obstacle than a limit is only asked not to get closer
    still, and to have room behind it; otherwise it sees no way at all until it is out."""
    path_step: int
    """Number of points of the path that "a little further on" means."""


class Visible(NamedTuple):
    """Indices of the furthest points of the path that the object sees; -1 for none."""

    free: int
    """Past the outer zone."""
    tight: int
    """Past the inner zone."""
    touching: int
    """Past the obstacles."""


@njit(nogil=True)
def _place_behind(view: View, point: NDArray[Any], behind: float) -> tuple[float, float]:
    """The place to push the object from towards a point, (u, v) [px]."""
    du, dv = view.position[0] - point[0], view.position[1] - point[1]
    length = max(np.sqrt(du * du + dv * dv), 1e-9)
    return view.position[0] + du / length * behind, view.position[1] + dv / length * behind


@njit(nogil=True)
def _has_room_behind(view: View, point: NDArray[Any], behind: float, clearance: float) -> bool:
    """Whether the place to push from is further than `clearance` from obstacles."""
    u, v = _place_behind(view, point, behind)
    return least_clearance(view.distance, u, v, u, v) > clearance


@njit(nogil=True)
def _tool_sees_behind(view: View, point: NDArray[Any], limits: Limits) -> bool:
    """Whether the straight line from the tool to that place is as far from obstacles."""
    u, v = _place_behind(view, point, limits.behind)
    return least_clearance(view.distance, u, v, view.tool[0], view.tool[1]) > limits.tool


@njit(nogil=True)
def _nearest_point(path: NDArray[Any], position: NDArray[Any]) -> int:
    """The index of the path's point nearest to a position."""
    nearest, least = 0, np.inf
    for k in range(path.shape[0]):
        away = (path[k, 0] - position[0]) ** 2 + (path[k, 1] - position[1]) ** 2
        if away < least:
            nearest, least = k, away
    return nearest


@njit(nogil=True)
def _furthest_visible(view: View, limits: Limits, nearest: int, near_obstacle: bool) -> Visible:
    """Look for visible points at every second one, from the goal back to the nearest one."""
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
        # Near an obstacle a clear way does not mean that there is room behind the object too.
        if near_obstacle and not _has_room_behind(view, point, limits.behind, limits.tool):
            continue
        if touching < 0:
            touching = k
        if clear > limits.inner and tight < 0:
            tight = k
        if clear > limits.outer:
            return Visible(k, tight, touching)  # clear of the outer zone is clear of the others
    return Visible(-1, tight, touching)


@njit(nogil=True)
def _fallback(view: View, limits: Limits, nearest: int, visible: Visible) -> int:
    """The index of the point to push towards where none is seen past the outer zone, or -1."""
    for k in visible:
        if k >= 0 and _tool_sees_behind(view, view.path[k], limits):
            return k
    ahead = min(nearest + limits.path_step, view.path.shape[0] - 1)
    u, v = view.path[nearest, 0], view.path[nearest, 1]
    path_is_clear = least_clearance(view.distance, u, v, u, v) > limits.outer
    if path_is_clear and _tool_sees_behind(view, view.path[nearest], limits):
        return ahead
    if visible.tight >= 0:
        return visible.tight
    if limits.relative:
        return visible.touching if visible.touching >= 0 else ahead
    return -1


@njit(nogil=True)
def look_ahead(view: View, limits: Limits) -> tuple[float, float]:
    """The point on the path to push towards now.

    It is the furthest one to which the object's way is clear of the outer zone. Failing that, in
    this order: the furthest clear of the inner zone, if the tool can see the place behind the
    object; the furthest that leaves the object room, if so; a point a little further on the path,
    if the path is clear there; the furthest clear of the inner zone; the target before.

    Args:
        view: The scene.
        limits: Distances to keep.

    Returns:
        (u, v) [px].
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
    nearest = _nearest_point(view.path, position)
    visible = _furthest_visible(view, limits, nearest, near_obstacle)
    k = visible.free
    if k < 0 or near_obstacle:
        k = _fallback(view, limits, nearest, visible)
    if k < 0 and view.first:
        k = min(nearest + limits.path_step, view.path.shape[0] - 1)
    if k < 0:
        return view.previous[0], view.previous[1]
    return view.path[k, 0], view.path[k, 1]
