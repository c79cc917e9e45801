"""From a planar action to joint targets: pure, batched, no simulator inside (spec 3)."""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from modpush.envs.kinematics import planar_inverse_kinematics, wrap_angle

__all__ = ["MotionConfig", "PlannedMotion", "clamp_to_workspace", "plan_motion", "ramp"]


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
