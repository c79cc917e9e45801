"""From a planar action to joint targets, for a batch of arms and without a simulator."""

from typing import Annotated, NamedTuple

import torch
from annotated_types import Le
from torch import Tensor

from modpush._types import Count, Length, Point, Positive
from modpush._validation import checked
from modpush.envs.robot.kinematics import planar_inverse_kinematics
from modpush.geometry.angles import wrap_angle

__all__ = [
    "MotionConfig",
    "PlannedMotion",
    "clamp_to_workspace",
    "plan_motion",
    "ramp",
]


@checked
class MotionConfig:
    """Motion of the tool by an action in [-1, 1]^3, and the limits of its position."""

    max_step: Length = 0.02
    """Largest translation per axis and control step [m]."""
    max_turn: Positive = 0.05
    """Largest rotation per control step [rad]."""
    anchor_distance: Length = 0.012
    """Largest distance from the measured tip to the target at the start of a step [m], so that a
    blocked arm does not wind up."""
    anchor_angle: Positive = 0.1
    """Largest yaw angle from the measured tip to the target at the start of a step [rad]."""
    low: Point = (0.08, -0.47)
    """Lower corner (x, y) of the tool's workspace, 12 cm outside the objects' workspace [m]."""
    high: Point = (0.87, 0.47)
    """Upper corner (x, y) of the tool's workspace [m]."""
    min_radius: Length = 0.16
    """Least distance of the tool from the robot's axis [m]."""
    max_radius: Length = 0.885
    """Largest distance of the tool from the robot's axis [m]."""
    num_knots: Annotated[Count, Le(1000)] = 4
    """Number of inverse kinematics solutions per control step; joint targets are interpolated between
    them. With one jump per step the tip would knock the object ahead instead of pushing it."""

    def __post_init__(self) -> None:
        """Check what depends on several fields."""
        if not self.max_radius > self.min_radius:
            raise ValueError(
                f"MotionConfig: max_radius must be > min_radius = {self.min_radius}, "
                f"got {self.max_radius}."
            )
        if not (self.low[0] < self.high[0] and self.low[1] < self.high[1]):
            raise ValueError(f"MotionConfig: low must be < high, got {self.low} and {self.high}.")


class PlannedMotion(NamedTuple):
    """Commands of one control step."""

    target: Tensor
    """Planar pose of the tip at the end of the step, yaw not wrapped, `[B, 3]` [m, m, rad]."""
    joints: Tensor
    """Joint targets at evenly spaced knots, the start included, `[B, num_knots + 1, 6]` [rad]."""
    reachable: Tensor
    """False where the commanded pose has no solution and the target stays, `[B]` bool."""


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
        tip_pose: The measured pose of the tip, `[B, 3]` [m, m, rad].
        flange_height: Height of the flange over the table, `[B]` [m].
        config: Step sizes, anchor and workspace.

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
    """Targets of the joint drives for each substep of a control step.

    Velocity targets go with the position targets: without them the drives' damping makes the tip lag
    by 7 mm at full speed, with them by 1 mm.

    Args:
        joints: Knots, the start included, `[..., K + 1, 6]` [rad].
        num_substeps: Number of physics steps per control step, `S`.
        control_freq: Control steps per second [Hz].

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
