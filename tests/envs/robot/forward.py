"""Forward kinematics of the UR5 by its Denavit-Hartenberg numbers, to check the inverse with."""

import math

import torch
from torch import Tensor

from modpush.envs.robot.kinematics import DH_A, DH_ALPHA, DH_D


def forward_kinematics(joint_position: Tensor) -> Tensor:
    """Pose of the flange in the base frame, `[..., 6]` [rad] to `[..., 4, 4]` [m]."""
    T = torch.eye(4, dtype=joint_position.dtype, device=joint_position.device)
    T = T.expand(*joint_position.shape[:-1], 4, 4)
    for i in range(6):
        T = T @ _dh_transform(joint_position[..., i], DH_D[i], DH_A[i], DH_ALPHA[i])
    return T


def _dh_transform(theta: Tensor, d: float, a: float, alpha: float) -> Tensor:
    """Rz(theta) Tz(d) Tx(a) Rx(alpha), `[..., 4, 4]`."""
    c, s = torch.cos(theta), torch.sin(theta)
    ca, sa = round(math.cos(alpha), 15), round(math.sin(alpha), 15)
    zero, one = torch.zeros_like(c), torch.ones_like(c)
    rows = [
        torch.stack([c, -s * ca, s * sa, a * c], -1),
        torch.stack([s, c * ca, -c * sa, a * s], -1),
        torch.stack([zero, sa * one, ca * one, d * one], -1),
        torch.stack([zero, zero, zero, one], -1),
    ]
    return torch.stack(rows, -2)


def planar_forward_kinematics(joint_position: Tensor) -> Tensor:
    """x, y, z [m] of the flange and the yaw [rad] of its x axis, `[..., 6]` to `[..., 4]`."""
    T = forward_kinematics(joint_position)
    yaw = torch.atan2(T[..., 1, 0], T[..., 0, 0])
    return torch.cat([T[..., :3, 3], yaw[..., None]], -1)
