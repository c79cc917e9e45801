"""Prediction of the motion of an object that a tool pushes, compiled.

It is that of quasi-static pushing (Lynch, Maekawa and Tanie 1992), with a slide: a tool that covers the
object pushes it out along the contact's normal, turns it where the normal passes beside its centre, and
it slides on against friction.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from modpush._kernels import njit

PARTS = 16
"""Number of parts of a step in which motion is predicted.

With longer ones a tool that meets a corner can be predicted to push the wrong side of the object.
"""

_SPACING = 0.008  # of the points on outlines [m]
_FLAT = 0.001  # by which points of an edge that touches may be farther away [m]

Pose = tuple[float, float, float]
"""x, y, yaw [m, m, rad]."""


class PushedScene(NamedTuple):
    """One scene as the prediction needs it, base frame; a compiled function takes it as it is."""

    object_pose: NDArray[np.float64]
    """x, y, yaw `[3]` [m, m, rad]."""
    velocity: NDArray[np.float64]
    """Motion and turn of the object in the step before `[3]` [m, m, rad]."""
    tip_pose: NDArray[np.float64]
    """x, y, yaw `[3]` [m, m, rad]."""
    support: NDArray[np.float64]
    """Reach of the object in n directions, the first along its own x, `[n]` [m]."""
    outline: NDArray[np.float64]
    """Points of its outline in its own axes, see `outline`, `[m, 2]` [m]."""
    directions: NDArray[np.float64]
    """These directions in its own axes, `[n, 2]`."""
    lever: float
    """Ratio of the torque that turns the object on the table to the force that moves it [m]."""
    tool: NDArray[np.float64]
    """Half of the sides of the tool's tip `[2]` [m]."""
    low_tool: NDArray[np.float64]
    """Points of the outline of what the tool has at the obstacles' height, in its axes, `[m, 2]` [m]."""
    distances: NDArray[np.float32]
    """Distance of each cell from the nearest obstacle that stands, `[H, W]` [m]."""
    grid: NDArray[np.float64]
    """u and v of the base frame's origin, and cells per metre, `[3]`."""
    moving: NDArray[np.float32]
    """The same from the obstacle that moves, `[H, W]`; `[0, 0]` where there is none."""
    drift: NDArray[np.float64]
    """Its way in a step `[2]`, until it turns round [m]."""
    turn: float
    """Number of steps after which it turns round; infinite if it does not."""
    ahead: int
    """Number of steps for which its way is looked ahead."""
    slack: int
    """Number of steps after which the object can still be pushed out of its way."""
    inner: NDArray[np.float64]
    """x0, y0, x1, y1 of the area into which the object may be pushed `[4]` [m]."""
    motion: NDArray[np.float64]
    """Motion and turn of the tool by an action of 1 `[3]` [m, m, rad]."""
    slowing: float
    """Speed that friction takes from the object in a step [m per step]."""
    clearance: float
    """Smallest distance of the tool from obstacles, and of the object while it is pushed aside [m]."""
    object_clearance: float
    """Smallest distance of the object from obstacles elsewhere, beside what its motion adds [m]."""


def directions(count: int) -> NDArray[np.float64]:
    """Unit vectors at equal angles, the first along x, `[count, 2]`."""
    angle = 2 * np.pi * np.arange(count) / count
    return np.stack([np.cos(angle), np.sin(angle)], -1)


def outline(support: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points on a convex outline, its corners among them, at most 8 mm apart, `[m, 2]` [m].

    The first one is the farthest from the origin. `support` says how far the outline reaches in n
    directions around a circle, `[n]` [m].
    """
    n = len(support)
    normals, step = directions(n), 2 * math.pi / n
    tangents = np.stack([-normals[:, 1], normals[:, 0]], -1)
    # Where the line at which it ends in one direction meets that of the next.
    aside = (np.roll(support, -1) - support * math.cos(step)) / math.sin(step)
    corners = support[:, None] * normals + aside[:, None] * tangents
    ways = np.roll(corners, -1, axis=0) - corners
    counts = np.ceil(np.linalg.norm(ways, axis=-1) / _SPACING - 1e-3).astype(int)
    parts = [
        corner + way * (np.arange(count)[:, None] / count)
        for corner, way, count in zip(corners, ways, counts, strict=True)
        if count
    ]
    points = np.concatenate(parts)
    return np.roll(points, -int(np.linalg.norm(points, axis=-1).argmax()), axis=0)


@njit()
def _depth(
    scene: PushedScene, px: float, py: float, ax: float, ay: float
) -> tuple[float, float, float]:
    """Shortest way by which the object gets out of a tool [m], and its direction.

    The tool's centre is (px, py) and its x axis (ax, ay) in the object's axes.
    """
    support, around, (long, wide) = scene.support, scene.directions, (scene.tool[0], scene.tool[1])
    n, least, nx, ny = len(support), np.inf, 0.0, 0.0
    for k in range(n):  # the object's sides
        ux, uy = around[k, 0], around[k, 1]
        reach = long * abs(ux * ax + uy * ay) + wide * abs(uy * ax - ux * ay)
        depth = support[k] + reach - (px * ux + py * uy)
        if depth < least:
            least, nx, ny = depth, -ux, -uy
            if depth <= 0.0:
                return 0.0, nx, ny
    turned = (math.atan2(ay, ax) + math.pi) / (2 * math.pi) * n
    for k in range(4):  # the tool's
        low = int(math.floor(turned))
        part = turned - low
        # Between two directions a footprint reaches less far than the line between them.
        reach = (1 - part) * support[low % n] + part * support[(low + 1) % n]
        depth = (wide if k % 2 else long) + reach + px * ax + py * ay
        if depth < least:
            least, nx, ny = depth, ax, ay
        ax, ay, turned = -ay, ax, turned + n / 4
    return max(least, 0.0), nx, ny


@njit()
def _offset(
    scene: PushedScene,
    px: float,
    py: float,
    ax: float,
    ay: float,
    nx: float,
    ny: float,
    depth: float,
) -> float:
    """Distance by which the normal (nx, ny) of a contact passes the object's centre on its left [m].

    Of two edges that touch along a part of them, it is the point nearest to the centre.
    """
    farthest, low, high = -np.inf, np.inf, -np.inf
    for again in (False, True):  # first the tool's farthest corner, then all that are as far
        for k in range(4):
            a = scene.tool[0] if k % 2 else -scene.tool[0]
            b = scene.tool[1] if k // 2 else -scene.tool[1]
            x, y = px + ax * a - ay * b, py + ay * a + ax * b
            along = x * nx + y * ny
            if not again:
                farthest = max(farthest, along)
            elif along >= farthest - depth - _FLAT:
                aside = y * nx - x * ny
                low, high = min(low, aside), max(high, aside)
    nearest, left, right = np.inf, -np.inf, np.inf
    for again in (False, True):  # the same of the object's outline
        for k in range(len(scene.outline)):
            x, y = scene.outline[k, 0], scene.outline[k, 1]
            along = x * nx + y * ny
            if not again:
                nearest = min(nearest, along)
            elif along <= nearest + depth + _FLAT:
                aside = y * nx - x * ny
                right, left = min(right, aside), max(left, aside)
    low, high = max(low, right), min(high, left)
    if low > high:
        return 0.5 * (low + high)
    return min(max(0.0, low), high)


@njit()
def _in_object(scene: PushedScene, pose: Pose, tip: Pose) -> tuple[float, float, float, float]:
    """The tool's centre (x, y) and its x axis, in the object's axes."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    dx, dy, turn = tip[0] - pose[0], tip[1] - pose[1], tip[2] - pose[2]
    return c * dx + s * dy, c * dy - s * dx, math.cos(turn), math.sin(turn)


@njit()
def _pushed(scene: PushedScene, pose: Pose, tip: Pose, inside: float) -> Pose:
    """Pose of the object after a tool has pushed it until the tool is no deeper in it than `inside`."""
    x, y, yaw = pose
    radius = math.hypot(scene.outline[0, 0], scene.outline[0, 1])
    if math.hypot(tip[0] - x, tip[1] - y) >= radius + math.hypot(scene.tool[0], scene.tool[1]):
        return pose
    px, py, ax, ay = _in_object(scene, pose, tip)
    depth, nx, ny = _depth(scene, px, py, ax, ay)
    if depth <= inside:
        return pose
    c, s = math.cos(yaw), math.sin(yaw)
    offset = -_offset(scene, px, py, ax, ay, nx, ny, depth) / scene.lever
    way = (depth - inside) / (1.0 + offset * offset)
    return (
        x + way * (c * nx - s * ny),
        y + way * (s * nx + c * ny),
        yaw + way * offset / scene.lever,
    )


@njit()
def tip_at(scene: PushedScene, action: NDArray[np.float64], acted: float) -> Pose:
    """Pose of the tool after an action of so many steps."""
    return (
        scene.tip_pose[0] + action[0] * scene.motion[0] * acted,
        scene.tip_pose[1] + action[1] * scene.motion[1] * acted,
        scene.tip_pose[2] + action[2] * scene.motion[2] * acted,
    )


@njit()
def object_after(
    scene: PushedScene, pose: Pose, speed: Pose, tip: Pose, inside: float
) -> tuple[Pose, Pose, bool]:
    """Pose and motion per step of the object after one of the parts of a step, and if it was pushed."""
    vx, vy, turn = speed
    whole = math.hypot(vx, vy) + scene.lever * abs(turn)
    kept = 1.0 - min(1.0, scene.slowing / (PARTS * whole)) if whole > 0.0 else 0.0
    vx, vy, turn = kept * vx, kept * vy, kept * turn
    slid = (pose[0] + vx / PARTS, pose[1] + vy / PARTS, pose[2] + turn / PARTS)
    after = _pushed(scene, slid, tip, inside)
    if after == slid:
        return slid, (vx, vy, turn), False
    after = _pushed(scene, after, tip, inside)  # what its turn has brought into the tool
    x, y, yaw = pose
    return (
        after,
        ((after[0] - x) * PARTS, (after[1] - y) * PARTS, (after[2] - yaw) * PARTS),
        True,
    )


@njit()
def start(scene: PushedScene) -> tuple[Pose, Pose, float]:
    """Pose of the object, its motion in the step before, and how deep the tool is in it [m].

    A tool in a notch of the object is inside its outline, which has none, and is not pushed out.
    """
    at, by = scene.object_pose, scene.velocity
    pose, speed = (at[0], at[1], at[2]), (by[0], by[1], by[2])
    tip = (scene.tip_pose[0], scene.tip_pose[1], scene.tip_pose[2])
    px, py, ax, ay = _in_object(scene, pose, tip)
    return pose, speed, _depth(scene, px, py, ax, ay)[0]


@njit()
def pose_after(action: NDArray[np.float64], scene: PushedScene) -> Pose:
    """Predicted pose of the object after a step with an action `[3]`, base frame [m, m, rad]."""
    pose, speed, inside = start(scene)
    for i in range(1, PARTS + 1):
        pose, speed, _ = object_after(scene, pose, speed, tip_at(scene, action, i / PARTS), inside)
    return pose
