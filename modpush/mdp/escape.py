"""Ways to push an object out of the way of an obstacle that moves, compiled.

On such a way the tool goes round the object and pushes it, until the obstacle passes it. An action is
harmless as long as there is one afterwards: a backup policy, as in predictive safety filters (Wabersich
and Zeilinger 2021, "A predictive safety filter for learning-based control").
"""

import math

import numpy as np

from modpush._kernels import njit
from modpush.mdp.body_distance import excess, outside, struck
from modpush.mdp.push_prediction import PARTS, Pose, PushedScene, object_after

_DIRECTIONS = 24  # in which the object is pushed
_GAP = 0.01  # between tool and object on the way round [m]
_BEHIND = 0.35  # angle from straight behind the object up to which the tool pushes [rad]
_ASIDE = 0.02  # distance of the tool from the line of the push that is corrected as fast as it pushes [m]

PushState = tuple[Pose, Pose, Pose, float]
"""Pose of the object, its motion in a step, pose of the tool, and how deep the tool is in the object."""


@njit()
def passes(scene: PushedScene, pose: Pose, first: int, last: int, clearance: float) -> bool:
    """True if the moving obstacle passes an object that stands at a pose, from a step to another."""
    for step in range(first, last + 1):
        if struck(scene, scene.outline, pose, float(step), clearance) > 0.0:
            return False
    return True


@njit()
def _heading(
    scene: PushedScene, pose: Pose, tip: Pose, angle: float, side: float
) -> tuple[float, float]:
    """Direction of a tool that goes round an object to push it at an angle, by the side 1 or -1."""
    x, y = tip[0] - pose[0], tip[1] - pose[1]
    away, c, s = max(math.hypot(x, y), 1e-6), math.cos(angle), math.sin(angle)
    if -(c * x + s * y) > away * math.cos(_BEHIND):
        aside = min(max((c * y - s * x) / _ASIDE, -1.0), 1.0)
        dx, dy = c + s * aside, s - c * aside
    else:
        room = math.hypot(scene.outline[0, 0], scene.outline[0, 1]) + _GAP
        room += math.hypot(scene.tool[0], scene.tool[1])
        out = min(max((room - away) / scene.motion[0], -1.0), 1.0)
        dx, dy = (out * x - side * y) / away, (out * y + side * x) / away
    length = math.hypot(dx, dy)
    return dx / length, dy / length


@njit()
def _cost(
    scene: PushedScene, state: PushState, first: int, angle: float, side: float, clearance: float
) -> float:
    """Number of steps after which the obstacle passes the object on one of the ways.

    Infinite where the tool comes nearer than `clearance` to an obstacle, or the object, unless it is near
    one already that stands and is not pushed; where the object is pushed over the edge, or the way takes
    more than half of the steps that are looked ahead.
    """
    pose, speed, tip, inside = state
    edge = outside(scene, pose)
    for step in range(scene.ahead // 2):
        if passes(scene, pose, first + step, scene.ahead, clearance):
            return float(step)
        dx, dy = _heading(scene, pose, tip, angle, side)
        dx, dy = dx * scene.motion[0] / PARTS, dy * scene.motion[1] / PARTS
        is_pushed = False
        for _ in range(PARTS):
            tip = (tip[0] + dx, tip[1] + dy, tip[2])
            pose, speed, pushed = object_after(scene, pose, speed, tip, inside)
            is_pushed = is_pushed or pushed
        after = float(first + step + 1)
        if struck(scene, scene.outline, pose, after, clearance) > 0.0:
            return np.inf
        if excess(scene, scene.low_tool, tip, after, clearance) > 0.0:
            return np.inf
        if is_pushed and outside(scene, pose) > edge:
            return np.inf
        if is_pushed and excess(scene, scene.outline, pose, after, clearance) > 0.0:
            return np.inf
    return np.inf


@njit()
def escape(
    scene: PushedScene, state: PushState, first: int, clearance: float, any_way: bool
) -> tuple[float, float, float]:
    """Cost of the best way, or of any that succeeds, and the tool's direction at its beginning (x, y).

    `state` counts as the one after `first` steps. The cost is the number of steps: 0 where the obstacle
    passes anyway, and infinite where no way succeeds. In both cases the direction is (0, 0).
    """
    best, dx, dy = np.inf, 0.0, 0.0
    pose, tip = state[0], state[2]
    if passes(scene, pose, first, scene.ahead, clearance):
        return 0.0, 0.0, 0.0
    from_tool = math.atan2(pose[1] - tip[1], pose[0] - tip[0])
    # Straight on, and always the same directions: a way that has been begun is there in the next step.
    for k in range(2 * _DIRECTIONS + 1):
        side = 1.0 if k % 2 else -1.0
        angle = from_tool if k == 0 else (k - 1) // 2 * 2 * math.pi / _DIRECTIONS
        cost = _cost(scene, state, first, angle, side, clearance)
        if cost < best:
            best = cost
            dx, dy = _heading(scene, pose, tip, angle, side)
            if any_way:
                break
    return best, dx, dy
