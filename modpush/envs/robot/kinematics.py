"""The UR5's inverse kinematics with the tool down, in closed form, batched, in plain torch.

Frames: the base frame is the Denavit-Hartenberg base of the arm (z up, the workspace on +x); the
flange frame is the last Denavit-Hartenberg frame (z out of the flange). Metres and radians.

Source: the published UR5 Denavit-Hartenberg numbers; the geometry of the solution is the textbook
one for an arm with three parallel axes and a wrist that does not intersect in a point.
"""

import math

import torch
from torch import Tensor

__all__ = ["DH_A", "DH_ALPHA", "DH_D", "planar_inverse_kinematics"]

# Denavit-Hartenberg offsets d, lengths a [m] and twists alpha [rad] of the six joints, from the shoulder
# to the flange; upper arm and forearm are the second and third lengths.
DH_D = (0.089159, 0.0, 0.0, 0.10915, 0.09465, 0.0823)
DH_A = (0.0, -0.425, -0.39225, 0.0, 0.0, 0.0)
DH_ALPHA = (math.pi / 2, 0.0, 0.0, math.pi / 2, -math.pi / 2, 0.0)

_D1, _, _, _D4, _D5, _D6 = DH_D
_, _A2, _A3, _, _, _ = DH_A


def _acos(cosine: Tensor) -> tuple[Tensor, Tensor]:
    """Arc cosine, and where it exists; a rounding error outside [-1, 1] is forgiven."""
    return torch.acos(cosine.clamp(-1.0, 1.0)), cosine.abs() <= 1.0 + 1e-9


def planar_inverse_kinematics(pose: Tensor, flange_height: float | Tensor) -> tuple[Tensor, Tensor]:
    """Joint angles that hold the tool straight down at a planar pose, in the working branch.

    With the tool down the wrist's bend is a right angle and the last joint follows yaw linearly,
    so the solution is continuous over the whole workspace and in an unwrapped yaw: no branch is
    searched and none can be jumped. Of the arm's eight branches two keep the elbow over the table (25 cm
    and more) and reach the whole workspace; this is the one whose shoulder angle does not wrap there.

    Args:
        pose: `[..., 3]` (x, y, yaw) of the flange [m, m, rad], base frame; yaw need not be wrapped.
        flange_height: Height of the flange over the base plane [m], a number or `[...]`.

    Returns:
        `(joint_position, reachable)`: `[..., 6]` [rad] and `[...]` bool. Unreachable poses get the
        angles of the nearest reach (finite, never NaN).

    Raises:
        ValueError: If the last dimension of `pose` is not 3.
    """
    if pose.shape[-1:] != (3,):
        raise ValueError(
            f"planar_inverse_kinematics: pose must be [..., 3] (x, y, yaw), got {tuple(pose.shape)}."
        )
    x, y, yaw = pose.unbind(-1)
    radius_sq = x * x + y * y
    swing, swing_ok = _acos(_D4 * torch.rsqrt(radius_sq.clamp_min(1e-12)))
    q1 = torch.atan2(y, x) - swing + math.pi / 2
    # How far the wrist is out along the arm's plane, less the offset of axis 5 that lies in it.
    r = torch.sqrt((radius_sq - _D4 * _D4).clamp_min(0.0)) - _D5
    h = torch.as_tensor(flange_height + _D6 - _D1, dtype=pose.dtype, device=pose.device)
    q3, elbow_ok = _acos((r * r + h * h - _A2 * _A2 - _A3 * _A3) / (2 * _A2 * _A3))
    q3 = -q3
    q2 = torch.atan2(h, r) - torch.atan2(_A3 * torch.sin(q3), _A2 + _A3 * torch.cos(q3))
    q4 = -1.5 * math.pi - q2 - q3  # keeps axis 5 level, pointing outwards
    q5 = torch.full_like(q1, math.pi / 2)
    q6 = q1 - yaw - math.pi / 2
    ok = swing_ok & elbow_ok & (radius_sq > 1e-12) & (q6.abs() <= 2 * math.pi)
    return torch.stack([q1, q2, q3, q4, q5, q6], -1), ok
