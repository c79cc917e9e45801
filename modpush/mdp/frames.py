"""The axes in which an agent sees and acts: the base's, the object's, or those of the planned path."""

from typing import Literal, get_args

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.envs import Transform

__all__ = ["ActionFrame", "Frame", "frame_yaw", "rotate", "wrap_angle"]

Frame = Literal["base", "object", "path"]
"""`"base"`: the robot's. `"object"`: turned with the object (the paper). `"path"`: x towards the
present sub-goal, as seen from the object."""


def wrap_angle(angle: Tensor) -> Tensor:
    """The same angle in [-pi, pi) [rad]."""
    return torch.remainder(angle + torch.pi, 2 * torch.pi) - torch.pi


def rotate(vectors: Tensor, angle: Tensor) -> Tensor:
    """Turn vectors counter-clockwise.

    Args:
        vectors: `[..., 2]`.
        angle: `[..., 1]` [rad].

    Returns:
        `[..., 2]`.
    """
    cos, sin = angle.cos(), angle.sin()
    x, y = vectors[..., :1], vectors[..., 1:]
    return torch.cat([cos * x - sin * y, sin * x + cos * y], -1)


def frame_yaw(frame: Frame, object_pose: Tensor, subgoal: Tensor | None = None) -> Tensor:
    """Angle of a frame's x axis in the robot's base frame.

    Args:
        frame: Which.
        object_pose: `[..., 3]` (x, y, yaw) [m, rad].
        subgoal: `[..., 2]` [m], base frame; needed for `"path"`.

    Returns:
        `[..., 1]` [rad]; 0 for `"path"` with a sub-goal at the object itself.

    Raises:
        ValueError: If the frame is unknown, or is `"path"` without a sub-goal.
    """
    check_frame("frame_yaw", frame)
    if frame == "base":
        return torch.zeros_like(object_pose[..., :1])
    if frame == "object":
        return object_pose[..., 2:]
    if subgoal is None:
        raise ValueError("frame_yaw: frame 'path' needs a sub-goal, got None.")
    ahead = subgoal - object_pose[..., :2]
    return torch.atan2(ahead[..., 1:], ahead[..., :1])


def check_frame(who: str, frame: str) -> None:
    """Raise a ValueError unless there is such a frame."""
    if frame not in get_args(Frame):
        raise ValueError(f"{who}: frame must be one of {get_args(Frame)}, got {frame!r}.")


class ActionFrame(Transform):
    """Lets the agent act in another frame: turns (dx, dy) of its action into the robot's base frame.

    The action's box is a square in the agent's axes. Turned, its corners would leave the
    environment's own box, so both components are shrunk alike there: the direction is kept.
    The yaw increment is the same in all frames.

    Args:
        frame: The agent's axes.
        action_key: Read and handed on to the environment, `[..., 3]` (dx, dy, dyaw) in [-1, 1].
        object_pose_key: Read, `[..., 3]` (x, y, yaw) [m, rad], base frame.
        subgoal_key: Read for `"path"`, `[..., 2]` [m], base frame.

    Raises:
        ValueError: If the frame is unknown.
        KeyError: If a key is missing when an action is turned.
    """

    def __init__(
        self,
        frame: Frame,
        *,
        action_key: NestedKey = "action",
        object_pose_key: NestedKey = "object_pose",
        subgoal_key: NestedKey = "subgoal",
    ) -> None:
        check_frame("ActionFrame", frame)
        super().__init__(in_keys_inv=[action_key], out_keys_inv=[action_key])
        self.frame = frame
        self.action_key = action_key
        self.object_pose_key = object_pose_key
        self.subgoal_key = subgoal_key

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        if self.frame == "base":
            return tensordict
        subgoal = self._read(tensordict, self.subgoal_key) if self.frame == "path" else None
        yaw = frame_yaw(self.frame, self._read(tensordict, self.object_pose_key), subgoal)
        action = self._read(tensordict, self.action_key)
        planar = rotate(action[..., :2], yaw)
        planar = planar / planar.abs().amax(-1, keepdim=True).clamp_min(1.0)
        return tensordict.set(self.action_key, torch.cat([planar, action[..., 2:]], -1))

    def _read(self, tensordict: TensorDictBase, key: NestedKey) -> Tensor:
        value = tensordict.get(key, None)
        if value is None:
            raise KeyError(
                f"ActionFrame: {key!r} is missing; there is "
                f"{sorted(map(str, tensordict.keys(True, True)))}."
            )
        return value
