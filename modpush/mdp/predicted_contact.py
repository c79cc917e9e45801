"""Prediction of the next contacts of tool and object with obstacles, compiled."""

import math

import numpy as np
from numpy.typing import NDArray

from modpush._kernels import njit
from modpush.mdp.body_distance import excess, outside, struck
from modpush.mdp.escape import escape, passes
from modpush.mdp.push_prediction import PARTS, Pose, PushedScene, object_after, start, tip_at

_LOOKED_AT = PARTS // 2  # parts after which distances are looked at
_ERROR = 0.2  # of the prediction, as a share of the object's motion
_DIRECTIONS = 17  # from straight back on one side to straight back on the other
_TURN_COST = 0.3  # of another turn, beside 1 for another motion
_ROOM = 0.02  # that is left beside a moving obstacle where that is possible [m]
_PENALTY = 1000.0  # of a violation [1/m]


@njit()
def _nearness(
    scene: PushedScene, points: NDArray[np.float64], pose: Pose, steps: float, clearance: float
) -> float:
    """By how much a body is too near to where an obstacle is, or will be after some steps [m]."""
    most = excess(scene, points, pose, steps, clearance)
    return max(most, struck(scene, points, pose, 0.0, clearance)) if len(scene.moving) else most


@njit()
def violation(action: NDArray[np.float64], scene: PushedScene, limit: float = np.inf) -> float:
    """By how much an action `[3]`, base frame, is predicted to come too near to something [m].

    After the action the tool stands still for a step, which is possible at any time. An object that is
    nearer than `object_clearance` already may stay as near, unless that is less than half of it. Of one
    that is at the edge, only its way further out counts. A sum of more than `limit` is not completed.
    """
    total, is_pushed = 0.0, False
    obstacles_move = len(scene.moving) > 0
    pose, speed, inside = start(scene)
    edge = outside(scene, pose)
    most = scene.object_clearance + 2 * _ERROR * scene.motion[0]
    away = most - _nearness(scene, scene.outline, pose, 0.0, most)
    fastest, radius = 0.0, math.hypot(scene.outline[0, 0], scene.outline[0, 1])
    moves = obstacles_move or speed != (0.0, 0.0, 0.0)
    for i in range(1, 2 * PARTS + 1):
        part = i / PARTS
        tip = tip_at(scene, action, min(part, 1.0))
        pose, speed, pushed = object_after(scene, pose, speed, tip, inside)
        is_pushed = is_pushed or pushed
        fastest = max(fastest, math.hypot(speed[0], speed[1]) + radius * abs(speed[2]))
        if i % _LOOKED_AT:
            continue
        if part <= 1.0 or obstacles_move:
            total += _nearness(scene, scene.low_tool, tip, part, scene.clearance)
        if is_pushed or moves:
            error = _ERROR * fastest
            clearance = min(scene.object_clearance + error, away)
            clearance = max(clearance, 0.5 * scene.object_clearance + error)
            total += _nearness(scene, scene.outline, pose, part, clearance)
        if total > limit:
            return total
    return total + max(0.0, outside(scene, pose) - edge) if is_pushed else total


@njit()
def _can_escape(action: NDArray[np.float64], scene: PushedScene) -> bool:
    """True if the object is out of a moving obstacle's way after an action, or can be pushed out.

    After the action the tool stands still for a step, in which the object slides on.
    """
    pose, speed, inside = start(scene)
    fastest, radius = 0.0, math.hypot(scene.outline[0, 0], scene.outline[0, 1])
    for i in range(1, 2 * PARTS + 1):
        tip = tip_at(scene, action, min(i / PARTS, 1.0))
        pose, speed, _ = object_after(scene, pose, speed, tip, inside)
        fastest = max(fastest, math.hypot(speed[0], speed[1]) + radius * abs(speed[2]))
    clearance = scene.clearance + _ERROR * fastest
    if passes(scene, pose, 1, scene.ahead, clearance):
        return True
    first = 1 + scene.slack
    if not passes(scene, pose, 1, first, clearance):
        return False
    state = (pose, (0.0, 0.0, 0.0), tip, inside)
    return escape(scene, state, first, clearance, True)[0] < np.inf


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
def _permitted(action: NDArray[np.float64], scene: PushedScene) -> NDArray[np.float64]:
    """An action itself if it comes not too near to anything; else the best of 175 others."""
    wrong = violation(action, scene)
    best, cost = action.copy(), _PENALTY * wrong
    if wrong <= 0.0:
        return best
    others, apart = _others(action)
    for i in np.argsort(apart):  # the nearest first, so that most are not looked at
        if apart[i] >= cost:
            break
        wrong = violation(others[i], scene, (cost - apart[i]) / _PENALTY)
        if apart[i] + _PENALTY * wrong < cost:
            best[:], cost = others[i], apart[i] + _PENALTY * wrong
    return best


@njit()
def nearest_action(action: NDArray[np.float64], scene: PushedScene) -> NDArray[np.float64]:
    """An action itself if nothing is predicted to come too near; else the best of 175 others.

    They move in 17 directions around the action's, at its speed but at least half of the largest, and at
    half of that, or not at all, and turn as the action does, not, the other way, or as fast as possible
    either way. The best has the smallest difference from the action and violation, weighted.

    If a moving obstacle comes towards the object, and after that action there would soon be no way left
    to push it aside, the first action of the quickest way takes its place, of those that leave 2 cm more
    if there is one; if none succeeds, the action stays. Actions are `[3]` in [-1, 1], base frame.
    """
    best = _permitted(action, scene)
    if not len(scene.moving) or _can_escape(best, scene):
        return best
    pose, speed, inside = start(scene)
    state = (pose, speed, tip_at(scene, best, 0.0), inside)
    for clearance in (scene.clearance + _ROOM, scene.clearance):
        cost, dx, dy = escape(scene, state, 0, clearance, False)
        if cost < np.inf:
            break
    if cost == np.inf:
        return best
    best[0], best[1], best[2] = dx, dy, 0.0
    return best if cost > 0.0 else _permitted(best, scene)  # the tool stands still
