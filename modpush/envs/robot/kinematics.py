"""UR5 kinematics in closed form, batched, in plain torch.

Frames: the base frame is the Denavit-Hartenberg base of the arm (z up, the workspace on +x); the
flange frame is the last Denavit-Hartenberg frame (z out of the flange). Metres and radians.

Source: the published UR5 Denavit-Hartenberg numbers; the geometry of the solution is the textbook
one for an arm with three parallel axes and a wrist that does not intersect in a point.
"""

import math

import torch
from torch import Tensor

from modpush.geometry.angles import wrap_angle

__all__ = [
    "DH_A",
    "DH_ALPHA",
    "DH_D",
    "NUM_BRANCHES",
    "WORKING_BRANCH",
    "forward_kinematics",
    "inverse_kinematics",
    "planar_forward_kinematics",
    "planar_inverse_kinematics",
    "tool_down_rotation",
]

DH_D = (0.089159, 0.0, 0.0, 0.10915, 0.09465, 0.0823)
DH_A = (0.0, -0.425, -0.39225, 0.0, 0.0, 0.0)
DH_ALPHA = (math.pi / 2, 0.0, 0.0, math.pi / 2, -math.pi / 2, 0.0)

NUM_BRANCHES = 8
"""Shoulder (2) x wrist (2) x elbow (2), in this order of significance."""

WORKING_BRANCH = 5
"""The branch the arm works in. Of the eight, two keep the elbow over the table (25 cm and more) and
reach the whole workspace with the tool down; this is the one whose shoulder angle does not wrap
there. Fixed, so that no step of a push can jump to another one."""

_D1, _, _, _D4, _D5, _D6 = DH_D
_, _A2, _A3, _, _, _ = DH_A


def forward_kinematics(joint_position: Tensor) -> Tensor:
    """Pose of the flange in the base frame.

    Args:
        joint_position: Joint angles, `[..., 6]` [rad].

    Returns:
        Homogeneous transforms `T_base_flange`, `[..., 4, 4]` [m].

    Raises:
        ValueError: If the last dimension is not 6.
    """
    if joint_position.shape[-1:] != (6,):
        raise ValueError(
            f"forward_kinematics: joint_position must be [..., 6], got {tuple(joint_position.shape)}."
        )
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


def inverse_kinematics(T_base_flange: Tensor) -> tuple[Tensor, Tensor]:
    """All joint solutions of a flange pose.

    Args:
        T_base_flange: Homogeneous transforms, `[..., 4, 4]` [m].

    Returns:
        `(joint_position, valid)`: the eight branches `[..., 8, 6]` [rad], each angle in [-pi, pi),
        and which of them exist, `[..., 8]` bool. Where a branch does not exist its angles are the
        nearest that do (finite, never NaN), and `valid` is False.

    Raises:
        ValueError: If the input is not `[..., 4, 4]`.
    """
    if T_base_flange.shape[-2:] != (4, 4):
        raise ValueError(
            f"inverse_kinematics: T_base_flange must be [..., 4, 4], got {tuple(T_base_flange.shape)}."
        )
    R, p = T_base_flange[..., :3, :3], T_base_flange[..., :3, 3]
    solutions, masks = [], []
    wrist = p - _D6 * R[..., :, 2]  # where the axes 5 and 6 meet
    radius = torch.linalg.vector_norm(wrist[..., :2], dim=-1)
    azimuth = torch.atan2(wrist[..., 1], wrist[..., 0])
    swing, swing_ok = _acos(_D4 / radius.clamp_min(1e-9))
    for shoulder in (1.0, -1.0):
        q1 = azimuth + shoulder * swing + math.pi / 2
        s1, c1 = torch.sin(q1), torch.cos(q1)
        bend, bend_ok = _acos((p[..., 0] * s1 - p[..., 1] * c1 - _D4) / _D6)
        for flip in (1.0, -1.0):
            q5 = flip * bend
            for elbow in (1.0, -1.0):
                q, ok = _finish(R, wrist, q1, q5, elbow)
                solutions.append(q)
                masks.append(ok & swing_ok & bend_ok)
    return torch.stack(solutions, -2), torch.stack(masks, -1)


def _finish(
    R: Tensor, wrist: Tensor, q1: Tensor, q5: Tensor, elbow: float
) -> tuple[Tensor, Tensor]:
    """The remaining four angles, once shoulder and wrist bend are chosen."""
    s1, c1, s5 = torch.sin(q1), torch.cos(q1), torch.sin(q5)
    # Axis 5 seen from the flange gives q6; with the wrist stretched (s5 = 0) q6 is free: take 0.
    nx = R[..., 0, 0] * s1 - R[..., 1, 0] * c1
    ny = R[..., 0, 1] * s1 - R[..., 1, 1] * c1
    free = s5.abs() < 1e-9
    sign = torch.where(s5 >= 0, 1.0, -1.0).to(s5)
    q6 = torch.where(free, torch.zeros_like(q5), torch.atan2(-ny * sign, nx * sign))
    # Axis 5 (z of the fourth frame) in the base frame.
    s6, c6 = torch.sin(q6)[..., None], torch.cos(q6)[..., None]
    axis5 = -(R[..., :, 0] * s6 + R[..., :, 1] * c6)
    # In the arm's plane: r outwards along (c1, s1), h upwards.
    ar, ah = axis5[..., 0] * c1 + axis5[..., 1] * s1, axis5[..., 2]
    r = wrist[..., 0] * c1 + wrist[..., 1] * s1 - _D5 * ar
    h = wrist[..., 2] - _D1 - _D5 * ah
    q3, ok = _acos((r * r + h * h - _A2 * _A2 - _A3 * _A3) / (2 * _A2 * _A3))
    q3 = elbow * q3
    q2 = torch.atan2(h, r) - torch.atan2(_A3 * torch.sin(q3), _A2 + _A3 * torch.cos(q3))
    # Axis 5 is (sin, -cos) of the sum of the three parallel joints.
    q4 = torch.atan2(ar, -ah) - q2 - q3
    return wrap_angle(torch.stack([q1, q2, q3, q4, q5, q6], -1)), ok


def _acos(cosine: Tensor) -> tuple[Tensor, Tensor]:
    """Arc cosine, and where it exists; a rounding error outside [-1, 1] is forgiven."""
    return torch.acos(cosine.clamp(-1.0, 1.0)), cosine.abs() <= 1.0 + 1e-9


def tool_down_rotation(yaw: Tensor) -> Tensor:
    """Rotation of a flange that points straight down, its x axis turned by `yaw` [rad], `[..., 3, 3]`."""
    c, s = torch.cos(yaw), torch.sin(yaw)
    zero, one = torch.zeros_like(c), torch.ones_like(c)
    return torch.stack(
        [
            torch.stack([c, s, zero], -1),
            torch.stack([s, -c, zero], -1),
            torch.stack([zero, zero, -one], -1),
        ],
        -2,
    )


def planar_inverse_kinematics(pose: Tensor, flange_height: float | Tensor) -> tuple[Tensor, Tensor]:
    """Joint angles that hold the tool straight down at a planar pose, in the working branch.

    With the tool down the wrist's bend is a right angle and the last joint follows yaw linearly,
    so the solution is continuous over the whole workspace and in an unwrapped yaw: no branch is
    searched and none can be jumped.

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


def planar_forward_kinematics(joint_position: Tensor) -> Tensor:
    """Planar pose of the flange, for a tool that points (about) straight down.

    Args:
        joint_position: `[..., 6]` [rad].

    Returns:
        `[..., 4]`: x, y, z [m] of the flange and the yaw [rad] in [-pi, pi) of its x axis.
    """
    T = forward_kinematics(joint_position)
    yaw = torch.atan2(T[..., 1, 0], T[..., 0, 0])
    return torch.cat([T[..., :3, 3], yaw[..., None]], -1)
