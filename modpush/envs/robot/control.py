"""From a planar action to joint targets: pure, batched, no simulator inside (spec 3)."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from modpush.envs.robot.kinematics import DH_A, DH_D, planar_inverse_kinematics
from modpush.geometry.angles import wrap_angle

__all__ = [
    "MotionConfig",
    "PlannedMotion",
    "clamp_to_workspace",
    "plan_motion",
    "plan_motion_cpu",
    "planar_joints_cpu",
    "ramp",
]


@dataclass(frozen=True, kw_only=True)
class MotionConfig:
    """How an action in [-1, 1]^3 moves the tool."""

    max_step: float = 0.02
    """Largest translation per axis and control step [m]."""
    max_turn: float = 0.05
    """Largest rotation per control step [rad]."""
    anchor_distance: float = 0.012
    """The target is kept within this of the measured tip before each step [m], so that a blocked
    arm does not wind up."""
    anchor_angle: float = 0.1
    """The same for yaw [rad]."""
    low: tuple[float, float] = (0.08, -0.47)
    """Lower corner of the tool's workspace [m]: the objects' less 0.12 m."""
    high: tuple[float, float] = (0.87, 0.47)
    """Upper corner of the tool's workspace [m]."""
    min_radius: float = 0.16
    """Nearest to the robot's axis [m]."""
    max_radius: float = 0.885
    """Farthest from the robot's axis [m]."""
    num_knots: int = 4
    """Inverse kinematics solves per control step; joint targets are ramped between them. With one
    jump a step the tip bats the object ahead instead of pushing it."""

    def __post_init__(self) -> None:
        """Check ranges."""
        for name in ("max_step", "max_turn", "anchor_distance", "anchor_angle", "min_radius"):
            if not getattr(self, name) > 0:
                raise ValueError(f"MotionConfig: {name} must be > 0, got {getattr(self, name)}.")
        if not self.max_radius > self.min_radius:
            raise ValueError(
                f"MotionConfig: max_radius must be > min_radius = {self.min_radius}, "
                f"got {self.max_radius}."
            )
        if not all(lo < hi for lo, hi in zip(self.low, self.high, strict=True)):
            raise ValueError(f"MotionConfig: low must be < high, got {self.low} and {self.high}.")
        if self.num_knots < 1:
            raise ValueError(f"MotionConfig: num_knots must be >= 1, got {self.num_knots}.")


class PlannedMotion(NamedTuple):
    """What one control step commands."""

    target: Tensor
    """Planar pose of the tip at the end of the step, `[B, 3]` [m, m, rad], yaw not wrapped."""
    joints: Tensor
    """Joint targets along the way, the start included, `[B, num_knots + 1, 6]` [rad]."""
    reachable: Tensor
    """False where the commanded pose has no solution and the target stayed, `[B]` bool."""


def plan_motion(
    action: Tensor,
    target: Tensor,
    tip_pose: Tensor,
    flange_height: Tensor,
    config: MotionConfig,
) -> PlannedMotion:
    """Turn an action into a ramp of joint targets.

    Args:
        action: `[B, 3]` in [-1, 1]; values beyond are clipped.
        target: The previous step's target, `[B, 3]` [m, m, rad].
        tip_pose: The tip as measured, `[B, 3]` [m, m, rad].
        flange_height: Of the flange over the table, `[B]` [m].
        config: Step sizes, anchor, workspace.

    Returns:
        The motion, in the dtype of `target`.
    """
    scale = target.new_tensor([config.max_step, config.max_step, config.max_turn])
    start = _anchor(target, tip_pose, config)
    goal = start + action.to(target.dtype).clamp(-1.0, 1.0) * scale
    goal = torch.cat([clamp_to_workspace(goal[:, :2], config), goal[:, 2:]], -1)
    fraction = torch.linspace(0, 1, config.num_knots + 1, dtype=target.dtype, device=target.device)
    way = start[:, None] + (goal - start)[:, None] * fraction[:, None]  # [B, K + 1, 3]
    joints, valid = planar_inverse_kinematics(way, flange_height[:, None])
    reachable = valid.all(-1)
    goal = torch.where(reachable[:, None], goal, start)
    joints = torch.where(reachable[:, None, None], joints, joints[:, :1])
    return PlannedMotion(goal, joints, reachable)


def _anchor(target: Tensor, tip_pose: Tensor, config: MotionConfig) -> Tensor:
    """The target, pulled to within the anchor's reach of the measured tip."""
    ahead = target[:, :2] - tip_pose[:, :2]
    distance = torch.linalg.vector_norm(ahead, dim=-1, keepdim=True)
    ahead = ahead * (config.anchor_distance / distance.clamp_min(1e-12)).clamp_max(1.0)
    turn = wrap_angle(target[:, 2] - tip_pose[:, 2])
    excess = turn - turn.clamp(-config.anchor_angle, config.anchor_angle)
    return torch.cat([tip_pose[:, :2] + ahead, (target[:, 2] - excess)[:, None]], -1)


def clamp_to_workspace(position: Tensor, config: MotionConfig) -> Tensor:
    """Nearest allowed tip positions, `[..., 2]` [m]: into the box, then into the ring."""
    low, high = position.new_tensor(config.low), position.new_tensor(config.high)
    position = torch.minimum(torch.maximum(position, low), high)
    radius = torch.linalg.vector_norm(position, dim=-1, keepdim=True).clamp_min(1e-12)
    return position * (radius.clamp(config.min_radius, config.max_radius) / radius)


def ramp(joints: Tensor, num_substeps: int, control_freq: float) -> tuple[Tensor, Tensor]:
    """Where the drives aim during each substep of a control step.

    The velocity goes with the position: without it the drives' damping makes the tip lag by 7 mm
    at full speed, with it by 1 mm.

    Args:
        joints: Knots, the start included, `[..., K + 1, 6]` [rad].
        num_substeps: Physics steps of the control step, `S`.
        control_freq: [Hz]

    Returns:
        Positions at the end of every substep, `[..., S, 6]` [rad], and velocities in it,
        `[..., S, 6]` [rad/s].
    """
    num_knots = joints.shape[-2] - 1
    at = torch.arange(1, num_substeps + 1, dtype=joints.dtype) * (num_knots / num_substeps)
    left = (torch.ceil(at - 1e-9).long() - 1).to(joints.device)
    start, step = joints[..., left, :], joints.diff(dim=-2)[..., left, :]
    fraction = (at.to(joints.device) - left).unsqueeze(-1)
    return start + fraction * step, step * (num_knots * control_freq)


def plan_motion_cpu(
    action: NDArray[np.float64],
    target: NDArray[np.float64],
    tip_pose: NDArray[np.float64],
    flange_height: NDArray[np.float64],
    config: MotionConfig,
    num_substeps: int,
    control_freq: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """`plan_motion` and `ramp` in one compiled call: the same numbers at a twentieth of the time.

    Torch spends 5 microseconds on an operation of eight numbers, and these are a hundred.

    Args:
        action: `[B, 3]` in [-1, 1].
        target: `[B, 3]` [m, m, rad].
        tip_pose: `[B, 3]` [m, m, rad].
        flange_height: `[B]` [m].
        config: Step sizes, anchor, workspace.
        num_substeps: Physics steps of the control step, `S`.
        control_freq: [Hz]

    Returns:
        New target `[B, 3]`, positions `[B, S, 6]` [rad], velocities `[B, S, 6]` [rad/s] and
        reachable `[B]`.
    """
    numbers = np.array(
        [
            config.max_step,
            config.max_turn,
            config.anchor_distance,
            config.anchor_angle,
            *config.low,
            *config.high,
            config.min_radius,
            config.max_radius,
        ]
    )
    return _plan(
        action,
        target,
        tip_pose,
        flange_height,
        numbers,
        config.num_knots,
        num_substeps,
        control_freq,
    )


def planar_joints_cpu(
    pose: NDArray[np.float64], flange_height: float
) -> tuple[NDArray[np.float64], bool]:
    """`kinematics.planar_inverse_kinematics` of one pose, compiled.

    Args:
        pose: `[3]` [m, m, rad].
        flange_height: [m]

    Returns:
        Joint position `[6]` [rad], and whether the pose can be reached.
    """
    joints = np.empty(6)
    return joints, bool(_planar_ik(pose, flange_height, joints))


@numba.njit(cache=True)
def _plan(action, target, tip, height, numbers, num_knots, num_substeps, control_freq):  # type: ignore[no-untyped-def]
    B = len(action)
    goals = np.empty((B, 3))
    position, velocity = np.empty((B, num_substeps, 6)), np.empty((B, num_substeps, 6))
    reachable = np.ones(B, np.bool_)
    start, goal, pose = np.empty(3), np.empty(3), np.empty(3)
    knots = np.empty((num_knots + 1, 6))
    for b in range(B):
        _start_and_goal(action[b], target[b], tip[b], numbers, start, goal)
        for k in range(num_knots + 1):
            for i in range(3):
                pose[i] = start[i] + (goal[i] - start[i]) * k / num_knots
            reachable[b] &= _planar_ik(pose, height[b], knots[k])
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


@numba.njit(cache=True)
def _start_and_goal(action, target, tip, numbers, start, goal):  # type: ignore[no-untyped-def]
    """`_anchor`, the step, and `clamp_to_workspace`."""
    max_step, max_turn, reach, max_angle = numbers[0], numbers[1], numbers[2], numbers[3]
    dx, dy = target[0] - tip[0], target[1] - tip[1]
    pull = min(reach / max(math.hypot(dx, dy), 1e-12), 1.0)
    turn = (target[2] - tip[2] + math.pi) % (2 * math.pi) - math.pi
    start[0], start[1] = tip[0] + dx * pull, tip[1] + dy * pull
    start[2] = target[2] - (turn - min(max(turn, -max_angle), max_angle))
    for i in range(2):
        goal[i] = start[i] + min(max(action[i], -1.0), 1.0) * max_step
        goal[i] = min(max(goal[i], numbers[4 + i]), numbers[6 + i])
    goal[2] = start[2] + min(max(action[2], -1.0), 1.0) * max_turn
    radius = max(math.hypot(goal[0], goal[1]), 1e-12)
    scale = min(max(radius, numbers[8]), numbers[9]) / radius
    goal[0] *= scale
    goal[1] *= scale


_D1, _D4, _D5, _D6 = DH_D[0], DH_D[3], DH_D[4], DH_D[5]
_A2, _A3 = DH_A[1], DH_A[2]


@numba.njit(cache=True)
def _planar_ik(pose, flange_height, q):  # type: ignore[no-untyped-def]
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
