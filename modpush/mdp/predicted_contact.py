"""Prediction of the next contacts of tool and object with obstacles, compiled."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from modpush._kernels import njit

_PARTS = (0.5, 1.0, 1.5)  # of a step, at which contacts are predicted
_SPACING = 0.008  # of the points on the tool's outline [m]
_DIRECTIONS = 17  # from straight back on one side to straight back on the other
_TURN_COST = 0.3  # of another turn, beside 1 for another motion
_PENALTY = 200.0  # of a violation [1/m]


class PushedScene(NamedTuple):
    """One scene as the prediction needs it, base frame; a compiled function takes it as it is."""

    object_pose: NDArray[np.float64]
    """x, y, yaw `[3]` [m, m, rad]."""
    tip_pose: NDArray[np.float64]
    """x, y, yaw `[3]` [m, m, rad]."""
    support: NDArray[np.float64]
    """How far the object reaches in n directions, the first along its own x, `[n]` [m]."""
    outline: NDArray[np.float64]
    """Distance of its outline from its centre in these directions, see `outline`, `[n]` [m]."""
    tool: NDArray[np.float64]
    """Half of the sides of the tool's tip `[2]` [m]."""
    distances: NDArray[np.float32]
    """Distance of each cell from the nearest blocked one, `[H, W]` [m]."""
    grid: NDArray[np.float64]
    """u and v of the base frame's origin, and cells per metre, `[3]`."""
    drift: NDArray[np.float64]
    """Way of the obstacles in a step `[2]` [m]."""
    inner: NDArray[np.float64]
    """x0, y0, x1, y1 of the area into which the object may be pushed `[4]` [m]."""
    motion: NDArray[np.float64]
    """Motion and turn of the tool by an action of 1 `[3]` [m, m, rad]."""
    clearance: float
    """Smallest distance from obstacles [m]."""


def outline(support: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance of a convex outline from the origin in n directions, `[..., n]` [m].

    `support` says how far it reaches in these directions, around a circle, `[..., n]` [m].
    """
    n = support.shape[-1]
    k = np.arange(n)
    away = np.cos(2 * np.pi * (k[:, None] - k) / n)
    # In each direction the first of the lines at which the object ends.
    lines = np.where(away > 0.1, away, np.nan)
    return np.asarray(np.nanmin(support[..., None, :] / lines, -1))


@njit()
def _distance(scene: PushedScene, x: float, y: float) -> float:
    """Distance of a point from the nearest blocked cell [m]."""
    height, width = scene.distances.shape
    u = int(round(scene.grid[0] - y * scene.grid[2]))
    v = int(round(scene.grid[1] - x * scene.grid[2]))
    return float(scene.distances[min(max(v, 0), height - 1), min(max(u, 0), width - 1)])


@njit()
def _gap(scene: PushedScene, x: float, y: float, part: float) -> float:
    """The same, from where obstacles are and where they will be."""
    dx, dy = scene.drift[0] * part, scene.drift[1] * part
    here = _distance(scene, x, y)
    return here if dx == 0.0 and dy == 0.0 else min(here, _distance(scene, x - dx, y - dy))


@njit()
def _tool_gap(scene: PushedScene, x: float, y: float, yaw: float, part: float) -> float:
    """Smallest distance of the outline of a tool from an obstacle [m]."""
    c, s, least = math.cos(yaw), math.sin(yaw), np.inf
    for side in range(2):
        half, other = scene.tool[side], scene.tool[1 - side]
        count = int(math.ceil(2 * half / _SPACING)) + 1
        for k in range(count):
            along = -half + 2 * half * k / (count - 1)
            for sign in (-1.0, 1.0):
                a, b = (along, sign * other) if side == 0 else (sign * other, along)
                least = min(least, _gap(scene, x + c * a - s * b, y + s * a + c * b, part))
    return least


@njit()
def _push(scene: PushedScene, x: float, y: float, yaw: float) -> tuple[float, float]:
    """How far a tool at a pose pushes the object, on the shortest way out of it [m]."""
    n, least, px, py = len(scene.support), np.inf, 0.0, 0.0
    dx, dy = x - scene.object_pose[0], y - scene.object_pose[1]
    for k in range(n):  # the object's sides
        angle = scene.object_pose[2] + 2 * math.pi * k / n
        nx, ny = math.cos(angle), math.sin(angle)
        reach = scene.tool[0] * abs(math.cos(angle - yaw)) + scene.tool[1] * abs(
            math.sin(angle - yaw)
        )
        depth = scene.support[k] + reach - (dx * nx + dy * ny)
        if depth < least:
            least, px, py = depth, -depth * nx, -depth * ny
    for k in range(4):  # the tool's
        angle = yaw + 0.5 * math.pi * k
        nx, ny = math.cos(angle), math.sin(angle)
        turned = (angle + math.pi - scene.object_pose[2]) / (2 * math.pi) * n
        low = int(math.floor(turned))
        part = turned - low
        # Between two directions a footprint reaches less far than the line between them.
        reach = (1 - part) * scene.support[low % n] + part * scene.support[(low + 1) % n]
        depth = scene.tool[k % 2] + reach + dx * nx + dy * ny
        if depth < least:
            least, px, py = depth, depth * nx, depth * ny
    return (px, py) if least > 0 else (0.0, 0.0)


@njit()
def _object_gap(scene: PushedScene, dx: float, dy: float, part: float) -> float:
    """Smallest distance of the outline of the object, moved by so much, from an obstacle [m]."""
    n, least = len(scene.support), np.inf
    for i in range(n):
        radius = scene.outline[i]
        angle = scene.object_pose[2] + 2 * math.pi * i / n
        x = scene.object_pose[0] + dx + radius * math.cos(angle)
        y = scene.object_pose[1] + dy + radius * math.sin(angle)
        least = min(least, _gap(scene, x, y, part))
    return least


@njit()
def violation(action: NDArray[np.float64], scene: PushedScene) -> float:
    """By how much an action `[3]`, base frame, is predicted to come too near to something [m]."""
    total = 0.0
    for part in _PARTS:
        x = scene.tip_pose[0] + action[0] * scene.motion[0] * part
        y = scene.tip_pose[1] + action[1] * scene.motion[1] * part
        yaw = scene.tip_pose[2] + action[2] * scene.motion[2] * part
        total += max(0.0, scene.clearance - _tool_gap(scene, x, y, yaw, part))
        dx, dy = _push(scene, x, y, yaw)
        if dx == 0.0 and dy == 0.0:
            continue
        total += max(0.0, scene.clearance - _object_gap(scene, dx, dy, part))
        ox, oy = scene.object_pose[0] + dx, scene.object_pose[1] + dy
        x0, y0, x1, y1 = scene.inner
        total += max(0.0, max(x0 - ox, ox - x1), max(y0 - oy, oy - y1))
    return total


@njit()
def nearest_action(action: NDArray[np.float64], scene: PushedScene) -> NDArray[np.float64]:
    """An action itself if nothing is predicted to come too near; else the best of 175 others.

    They move in 17 directions around the action's, at its speed but at least half of the largest, and at
    half of that, or not at all, and turn as the action does, not, the other way, or as fast as possible
    either way. The best has the smallest difference from the action and violation, weighted. Actions are
    `[3]` in [-1, 1], base frame.
    """
    wrong = violation(action, scene)
    if wrong <= 0.0:
        return action
    best, cost = action.copy(), _PENALTY * wrong
    speed = max(math.hypot(action[0], action[1]), 0.5)
    heading, tried = math.atan2(action[1], action[0]), np.empty(3)
    for turn in (action[2], 0.0, -action[2], 1.0, -1.0):
        tried[2] = turn
        for k in range(2 * _DIRECTIONS + 1):
            length = (0.5 * speed, speed, 0.0)[k // _DIRECTIONS]
            angle = heading + math.pi * (k % _DIRECTIONS - _DIRECTIONS // 2) / 9
            tried[0], tried[1] = length * math.cos(angle), length * math.sin(angle)
            largest = max(abs(tried[0]), abs(tried[1]), 1.0)
            tried[0], tried[1] = tried[0] / largest, tried[1] / largest
            apart = math.hypot(tried[0] - action[0], tried[1] - action[1])
            other = apart + _TURN_COST * abs(turn - action[2])
            if other < cost:
                other += _PENALTY * violation(tried, scene)
                if other < cost:
                    best[:], cost = tried, other
    return best
