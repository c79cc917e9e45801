"""`modpush.envs.robot.control` for arms on a CPU, compiled."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from modpush._kernels import njit
from modpush.envs.robot.control import MotionConfig
from modpush.envs.robot.kinematics import DH_A, DH_D

__all__ = ["plan_motion_cpu", "planar_joints_cpu", "start_joints"]

_D1, _D4, _D5, _D6 = DH_D[0], DH_D[3], DH_D[4], DH_D[5]
_A2, _A3 = DH_A[1], DH_A[2]


def plan_motion_cpu(
    action: NDArray[np.float64],
    target: NDArray[np.float64],
    tip_pose: NDArray[np.float64],
    flange_height: NDArray[np.float64],
    config: MotionConfig,
    num_substeps: int,
    control_freq: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """`plan_motion` and `ramp` in one compiled call, which takes a twentieth of their time.

    Torch spends 5 microseconds on an operation of eight numbers, and these are a hundred operations.

    Args:
        action: `[B, 3]` in [-1, 1].
        target: The previous step's target, `[B, 3]` [m, m, rad].
        tip_pose: The measured pose of the tip, `[B, 3]` [m, m, rad].
        flange_height: Height of the flange over the table, `[B]` [m].
        config: Step sizes, anchor and workspace.
        num_substeps: Number of physics steps per control step, `S`.
        control_freq: Control steps per second [Hz].

    Returns:
        New target `[B, 3]`, positions `[B, S, 6]` [rad], velocities `[B, S, 6]` [rad/s] and
        reachable `[B]`.
    """
    limits = _Limits(
        config.max_step,
        config.max_turn,
        config.anchor_distance,
        config.anchor_angle,
        config.low,
        config.high,
        config.min_radius,
        config.max_radius,
    )
    return _plan(
        action,
        target,
        tip_pose,
        flange_height,
        limits,
        config.num_knots,
        num_substeps,
        control_freq,
    )


class _Limits(NamedTuple):
    """The fields of `MotionConfig` that the compiled functions read; see there."""

    max_step: float
    max_turn: float
    anchor_distance: float
    anchor_angle: float
    low: tuple[float, float]
    high: tuple[float, float]
    min_radius: float
    max_radius: float


def planar_joints_cpu(
    pose: NDArray[np.float64], flange_height: float
) -> tuple[NDArray[np.float64], bool]:
    """`kinematics.planar_inverse_kinematics` of one pose, compiled.

    Args:
        pose: x, y, yaw of the flange, `[3]` [m, m, rad].
        flange_height: Height of the flange over the table [m].

    Returns:
        Joint position `[6]` [rad], and whether the pose can be reached.
    """
    joints = np.empty(6)
    return joints, bool(_planar_ik(pose, flange_height, joints))


def start_joints(
    tool_pose: Sequence[float], tip_height: float, tool_length: float
) -> NDArray[np.float32]:
    """Angles of the joints that hold the tool's tip at a pose, `[6]` [rad].

    Args:
        tool_pose: x, y, yaw of the tip [m, m, rad].
        tip_height: Height of the tip over the table [m].
        tool_length: Distance from the flange to the tip [m].

    Raises:
        ValueError: If the arm cannot reach the pose.
    """
    joints, reachable = planar_joints_cpu(np.array(tool_pose), tip_height + tool_length)
    if not reachable:
        raise ValueError(
            f"Scenario: tool_pose must not be out of the arm's reach, got {tuple(tool_pose)}."
        )
    return joints.astype(np.float32)


@njit()
def _plan(
    action: NDArray[np.float64],
    target: NDArray[np.float64],
    tip_pose: NDArray[np.float64],
    flange_height: NDArray[np.float64],
    limits: _Limits,
    num_knots: int,
    num_substeps: int,
    control_freq: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """`plan_motion` and `ramp`, see `plan_motion_cpu`."""
    B = len(action)
    goals = np.empty((B, 3))
    position, velocity = np.empty((B, num_substeps, 6)), np.empty((B, num_substeps, 6))
    reachable = np.ones(B, np.bool_)
    start, goal, pose = np.empty(3), np.empty(3), np.empty(3)
    knots = np.empty((num_knots + 1, 6))
    for b in range(B):
        _start_and_goal(action[b], target[b], tip_pose[b], limits, start, goal)
        for k in range(num_knots + 1):
            for i in range(3):
                pose[i] = start[i] + (goal[i] - start[i]) * k / num_knots
            reachable[b] &= _planar_ik(pose, flange_height[b], knots[k])
        if not reachable[b]:
            goal[:] = start
            for k in range(1, num_knots + 1):
                knots[k] = knots[0]
        goals[b] = goal
        for s in range(num_substeps):
            at = (s + 1) * num_knots / num_substeps
            left = int(math.ceil(at - 1e-9)) - 1
            for j in range(6):
                step = knots[left + 1, j] - knots[left, j]
                position[b, s, j] = knots[left, j] + (at - left) * step
                velocity[b, s, j] = step * (num_knots * control_freq)
    return goals, position, velocity, reachable


@njit()
def _start_and_goal(
    action: NDArray[np.float64],
    target: NDArray[np.float64],
    tip_pose: NDArray[np.float64],
    limits: _Limits,
    start: NDArray[np.float64],
    goal: NDArray[np.float64],
) -> None:
    """Write where one step starts and ends: `_anchor`, the step, and `clamp_to_workspace`."""
    dx, dy = target[0] - tip_pose[0], target[1] - tip_pose[1]
    pull = min(limits.anchor_distance / max(math.hypot(dx, dy), 1e-12), 1.0)
    turn = (target[2] - tip_pose[2] + math.pi) % (2 * math.pi) - math.pi
    start[0], start[1] = tip_pose[0] + dx * pull, tip_pose[1] + dy * pull
    start[2] = target[2] - (turn - min(max(turn, -limits.anchor_angle), limits.anchor_angle))
    for i in range(2):
        goal[i] = start[i] + min(max(action[i], -1.0), 1.0) * limits.max_step
        goal[i] = min(max(goal[i], limits.low[i]), limits.high[i])
    goal[2] = start[2] + min(max(action[2], -1.0), 1.0) * limits.max_turn
    radius = max(math.hypot(goal[0], goal[1]), 1e-12)
    scale = min(max(radius, limits.min_radius), limits.max_radius) / radius
    goal[0] *= scale
    goal[1] *= scale


@njit()
def _planar_ik(pose: NDArray[np.float64], flange_height: float, q: NDArray[np.float64]) -> bool:
    """`kinematics.planar_inverse_kinematics` for one pose; writes `q`, returns reachable."""
    x, y, yaw = pose
    radius_sq = x * x + y * y
    lever = _D4 / math.sqrt(max(radius_sq, 1e-12))
    q[0] = math.atan2(y, x) - math.acos(min(max(lever, -1.0), 1.0)) + math.pi / 2
    r = math.sqrt(max(radius_sq - _D4 * _D4, 0.0)) - _D5
    h = flange_height + _D6 - _D1
    bend = (r * r + h * h - _A2 * _A2 - _A3 * _A3) / (2 * _A2 * _A3)
    q[2] = -math.acos(min(max(bend, -1.0), 1.0))
    q[1] = math.atan2(h, r) - math.atan2(_A3 * math.sin(q[2]), _A2 + _A3 * math.cos(q[2]))
    q[3] = -1.5 * math.pi - q[1] - q[2]
    q[4] = math.pi / 2
    q[5] = q[0] - yaw - math.pi / 2
    within = abs(lever) <= 1 + 1e-9 and abs(bend) <= 1 + 1e-9
    return within and radius_sq > 1e-12 and abs(q[5]) <= 2 * math.pi
