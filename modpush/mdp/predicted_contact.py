"""Prediction of the next contacts of tool and object with obstacles, compiled."""

import math

import numpy as np
from numpy.typing import NDArray

from modpush._kernels import njit
from modpush.mdp.push_prediction import PARTS, Pose, PushedScene, object_after, start, tip_at

_STOP = 4  # parts in which the tool stands still after the step, while the object slides on
_ERROR = 0.2  # of the prediction, as a share of the object's motion
_DIRECTIONS = 17  # from straight back on one side to straight back on the other
_TURN_COST = 0.3  # of another turn, beside 1 for another motion
_PENALTY = 200.0  # of a violation [1/m]


@njit()
def _distance(
    distances: NDArray[np.float32], grid: NDArray[np.float64], x: float, y: float
) -> float:
    """Distance of a point from the nearest blocked cell, between the cells' centres interpolated [m]."""
    height, width = distances.shape
    u = min(max(grid[0] - y * grid[2], 0.0), width - 1.001)
    v = min(max(grid[1] - x * grid[2], 0.0), height - 1.001)
    i, j = int(v), int(u)
    a, b = v - i, u - j
    upper = (1 - b) * distances[i, j] + b * distances[i, j + 1]
    lower = (1 - b) * distances[i + 1, j] + b * distances[i + 1, j + 1]
    return float((1 - a) * upper + a * lower - 0.5 / grid[2])


@njit()
def _nearest(
    distances: NDArray[np.float32],
    grid: NDArray[np.float64],
    points: NDArray[np.float64],
    pose: Pose,
    enough: float,
) -> float:
    """Distance of the nearest of some points of a body from a blocked cell; about it beyond `enough` [m].

    The points `[m, 2]` are in the body's axes [m], the first the farthest from its origin.
    """
    x, y, yaw = pose
    least = _distance(distances, grid, x, y)
    if least - math.hypot(points[0, 0], points[0, 1]) >= enough:
        return enough
    c, s = math.cos(yaw), math.sin(yaw)
    for i in range(len(points)):
        u, v = x + c * points[i, 0] - s * points[i, 1], y + s * points[i, 0] + c * points[i, 1]
        least = min(least, _distance(distances, grid, u, v))
    return least


@njit()
def _struck(
    scene: PushedScene, points: NDArray[np.float64], pose: Pose, part: float, clearance: float
) -> float:
    """By how much a body is too near to where the moving obstacle will be [m]."""
    there = (pose[0] - scene.drift[0] * part, pose[1] - scene.drift[1] * part, pose[2])
    return max(0.0, clearance - _nearest(scene.moving, scene.grid, points, there, clearance))


@njit()
def _excess(
    scene: PushedScene, points: NDArray[np.float64], pose: Pose, part: float, clearance: float
) -> float:
    """By how much a body is too near to an obstacle, where it is and where it will be [m]."""
    excess = max(0.0, clearance - _nearest(scene.distances, scene.grid, points, pose, clearance))
    if len(scene.moving):
        excess = max(excess, _struck(scene, points, pose, part, clearance))
    return excess


@njit()
def violation(action: NDArray[np.float64], scene: PushedScene, limit: float = np.inf) -> float:
    """By how much an action `[3]`, base frame, is predicted to come too near to something [m].

    After the action the tool stands still, which is possible at any time. A sum of more than `limit` is
    not added up to its end.
    """
    total, is_pushed = 0.0, False
    obstacles_move = len(scene.moving) > 0
    pose, speed, inside = start(scene)
    fastest, radius = 0.0, math.hypot(scene.outline[0, 0], scene.outline[0, 1])
    moves = obstacles_move or speed != (0.0, 0.0, 0.0)
    for i in range(1, PARTS + _STOP + 1):
        part = i / PARTS
        tip = tip_at(scene, action, min(part, 1.0))
        pose, speed, pushed = object_after(scene, pose, speed, tip, inside)
        is_pushed = is_pushed or pushed
        fastest = max(fastest, math.hypot(speed[0], speed[1]) + radius * abs(speed[2]))
        if i % 2:
            continue
        if part <= 1.0 or obstacles_move:
            total += _excess(scene, scene.tip, tip, part, scene.clearance)
        if is_pushed or moves:
            clearance = scene.clearance + _ERROR * fastest
            total += _excess(scene, scene.outline, pose, part, clearance)
        if total > limit:
            return total
    if is_pushed:
        x0, y0, x1, y1 = scene.inner
        total += max(0.0, max(x0 - pose[0], pose[0] - x1), max(y0 - pose[1], pose[1] - y1))
    return total


@njit()
def strike(action: NDArray[np.float64], scene: PushedScene, limit: float = np.inf) -> float:
    """By how much the moving obstacle is predicted to come too near to the object [m].

    The action `[3]`, base frame, is taken in all steps that are looked ahead. A sum of more than `limit`
    is not added up to its end.
    """
    total, clearance = 0.0, scene.clearance
    pose, speed, inside = start(scene)
    for i in range(1, PARTS * scene.ahead + 1):
        part = i / PARTS
        pose, speed, _ = object_after(scene, pose, speed, tip_at(scene, action, part), inside)
        if i % PARTS == 0:
            total += _struck(scene, scene.outline, pose, part, clearance)
        if total > limit:
            return total
    return total


@njit()
def _others(action: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The actions that may take another's place, `[n, 3]`, and how different they are, `[n]`."""
    speed = max(math.hypot(action[0], action[1]), 0.5)
    heading, count = math.atan2(action[1], action[0]), 2 * _DIRECTIONS + 1
    others, apart = np.empty((5 * count, 3)), np.empty(5 * count)
    for i, turn in enumerate((action[2], 0.0, -action[2], 1.0, -1.0)):
        for k in range(count):
            length = (0.5 * speed, speed, 0.0)[k // _DIRECTIONS]
            angle = heading + math.pi * (k % _DIRECTIONS - _DIRECTIONS // 2) / 9
            x, y = length * math.cos(angle), length * math.sin(angle)
            largest = max(abs(x), abs(y), 1.0)
            other = others[i * count + k]
            other[0], other[1], other[2] = x / largest, y / largest, turn
            away = math.hypot(other[0] - action[0], other[1] - action[1])
            apart[i * count + k] = away + _TURN_COST * abs(turn - action[2])
    return others, apart


@njit()
def nearest_action(action: NDArray[np.float64], scene: PushedScene) -> NDArray[np.float64]:
    """An action itself if nothing is predicted to come too near; else the best of 175 others.

    They move in 17 directions around the action's, at its speed but at least half of the largest, and at
    half of that, or not at all, and turn as the action does, not, the other way, or as fast as possible
    either way. The best has the smallest difference from the action and violation, weighted. Actions are
    `[3]` in [-1, 1], base frame.
    """
    wrong = violation(action, scene)
    comes = len(scene.moving) > 0 and strike(np.zeros(3), scene) > 0.0
    if comes:
        wrong += strike(action, scene)
    if wrong <= 0.0:
        return action
    best, cost = action.copy(), _PENALTY * wrong
    others, apart = _others(action)
    for i in np.argsort(apart):  # the nearest first, so that most are not looked at
        if apart[i] >= cost:
            break
        allowed = (cost - apart[i]) / _PENALTY
        wrong = violation(others[i], scene, allowed)
        if comes and wrong < allowed:
            wrong += strike(others[i], scene, allowed - wrong)
        if apart[i] + _PENALTY * wrong < cost:
            best[:], cost = others[i], apart[i] + _PENALTY * wrong
    return best
