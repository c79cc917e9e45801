"""Frames of observations and actions: the base's, the object's, or the planned path's."""

from typing import Literal, get_args

import torch
from torch import Tensor


def wrap_angle(angle: Tensor) -> Tensor:
    """The same angle in [-pi, pi) [rad], for a real tensor of any shape."""
    return torch.remainder(angle + torch.pi, 2 * torch.pi) - torch.pi


def direction_of(vector: Tensor) -> Tensor:
    """Heading of vectors `[..., 2]`, `[...]` in [-pi, pi] [rad]."""
    return torch.atan2(vector[..., 1], vector[..., 0])


def rotate(vectors: Tensor, angle: Tensor) -> Tensor:
    """Rotate vectors counter-clockwise.

    Args:
        vectors: `[..., 2]`.
        angle: `[..., 1]` [rad].

    Returns:
        `[..., 2]`.

    Raises:
        ValueError: If a last dimension differs from the expected one.
    """
    if vectors.shape[-1:] != (2,) or angle.shape[-1:] != (1,):
        raise ValueError(
            f"rotate: expected vectors [..., 2] and angle [..., 1], got {list(vectors.shape)} and "
            f"{list(angle.shape)}."
        )
    cos, sin = angle.cos(), angle.sin()
    x, y = vectors[..., :1], vectors[..., 1:]
    return torch.cat([cos * x - sin * y, sin * x + cos * y], -1)


Frame = Literal["base", "object", "path"]
"""`"base"`: the axes of the robot's base. `"object"`: rotated with the object, as in the paper.
`"path"`: x points from the object to the present sub-goal."""


def frame_yaw(frame: Frame, object_pose: Tensor, subgoal: Tensor | None = None) -> Tensor:
    """Angle of a frame's x axis in the robot's base frame, `[..., 1]` [rad].

    Args:
        frame: Name of the frame.
        object_pose: `[..., 3]` (x, y, yaw) [m, rad].
        subgoal: `[..., 2]` [m], base frame; needed for `"path"`, and 0 is returned where the object is
            there.

    Raises:
        ValueError: If the frame is unknown or `"path"` without a sub-goal, or the pose has another shape.
    """
    if object_pose.shape[-1:] != (3,):
        raise ValueError(f"frame_yaw: object_pose must be [..., 3], got {list(object_pose.shape)}.")
    if frame == "base":
        return torch.zeros_like(object_pose[..., :1])
    if frame == "object":
        return object_pose[..., 2:]
    if frame not in get_args(Frame):
        raise ValueError(f"frame must be one of {get_args(Frame)}, got {frame!r}.")
    if subgoal is None:
        raise ValueError("frame_yaw: frame 'path' needs a sub-goal, got subgoal=None.")
    ahead = subgoal - object_pose[..., :2]
    return torch.atan2(ahead[..., 1:], ahead[..., :1])
