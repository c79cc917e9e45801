"""`ActionFrame`: lets an agent act in axes of its own."""

from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor

from modpush._checks import read_key
from modpush._transforms import DescribedTransform
from modpush._validation import checked_arguments
from modpush.geometry.frames import Frame, frame_yaw, rotate

_AGENT_ACTION = "_agent_action"
"""Key under which the agent's action waits while the environment steps with the turned one."""


class ActionFrame(DescribedTransform):
    """Turns (dx, dy) of the agent's action into the robot's base frame on its way to the environment.

    The action's box is a square in the agent's axes. Turned, its corners would leave the
    environment's own box, so both components are shrunk alike there: the direction is kept.
    The yaw increment is the same in all frames. What is stored is the agent's action, and transforms
    after this one read the agent's action too: put it before those that read the action, such as
    `PushObservation` and `PushReward`.

    Args:
        frame: The agent's axes: `"object"`, `"path"` or `"base"`.
        action_key: Read and handed on to the environment, `[..., 3]` (dx, dy, dyaw) in [-1, 1].
        object_pose_key: Read, `[..., 3]` (x, y, yaw) [m, rad], base frame.
        subgoal_key: Read for `"path"`, `[..., 2]` [m], base frame.

    Raises:
        ValueError: If the frame is unknown.
        KeyError: If a key is missing when an action is turned.
        RuntimeError: If it turns actions in a replay buffer, where the agent's own are stored.
    """

    @checked_arguments
    def __init__(
        self,
        frame: Frame,
        *,
        action_key: NestedKey = "action",
        object_pose_key: NestedKey = "object_pose",
        subgoal_key: NestedKey = "subgoal",
    ) -> None:
        super().__init__(in_keys_inv=[action_key], out_keys_inv=[action_key])
        self.frame = frame
        self.action_key = action_key
        self.object_pose_key = object_pose_key
        self.subgoal_key = subgoal_key

    def describe(self) -> dict[str, Any]:
        """The agent's axes."""
        return {"action_frame": self.frame}

    def _yaw(self, tensordict: TensorDictBase) -> Tensor:
        pose = read_key(tensordict, self.object_pose_key, 3)
        subgoal = None
        if self.frame == "path":
            subgoal = read_key(tensordict, self.subgoal_key, 2)
        return frame_yaw(self.frame, pose, subgoal)

    def to_agent(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Turn an action in the base frame into the agent's axes, in place.

        For a policy that acts in the base frame, such as a controller, in an agent's environment. Where
        (dx, dy) is longer than 1 it is cut to the agent's box, so that its direction may change.

        Raises:
            KeyError: If a key is missing.
        """
        action = read_key(tensordict, self.action_key, 3)
        planar = rotate(action[..., :2], -self._yaw(tensordict))
        turned = torch.cat([planar, action[..., 2:]], -1).clamp(-1.0, 1.0)
        return tensordict.set(self.action_key, turned)

    def to_base(self, tensordict: TensorDictBase) -> Tensor:
        """The agent's action in the base frame, as the environment takes it, `[..., 3]`.

        Raises:
            KeyError: If a key is missing.
        """
        action = read_key(tensordict, self.action_key, 3)
        return action if self.frame == "base" else turn_action(action, self._yaw(tensordict))

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        self._check_place()
        if self.frame == "base":
            return tensordict
        action, turned = read_key(tensordict, self.action_key, 3), self.to_base(tensordict)
        tensordict.set(_AGENT_ACTION, action)
        return tensordict.set(self.action_key, turned)

    def _check_place(self) -> None:
        """Refuse to act in a replay buffer, whose transforms are in a `Compose` of no environment."""
        try:
            self.container  # noqa: B018  # TorchRL raises for such a Compose
        except ValueError:
            raise RuntimeError(
                "ActionFrame: it belongs to an environment; in a replay buffer it would turn the stored "
                "actions, which are the agent's own."
            ) from None

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        # TorchRL hands the transforms the tensordict that the environment was stepped with.
        action = tensordict.pop(_AGENT_ACTION, None)
        if action is not None:
            tensordict.set(self.action_key, action)
        return next_tensordict


def turn_action(action: Tensor, yaw: Tensor) -> Tensor:
    """Turn (dx, dy) of an action `[..., 3]` by an angle `[..., 1]` [rad].

    Both are shortened alike where one would leave the box [-1, 1].
    """
    planar = rotate(action[..., :2], yaw)
    planar = planar / planar.abs().amax(-1, keepdim=True).clamp_min(1.0)
    return torch.cat([planar, action[..., 2:]], -1)
