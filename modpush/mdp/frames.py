"""`ActionFrame`: the axes in which an agent acts, as a TorchRL transform."""

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.envs import Transform

from modpush.geometry.angles import rotate
from modpush.geometry.frames import Frame, check_frame, frame_yaw

__all__ = ["ActionFrame"]


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
