"""`PushHistory`: the last steps in which the object was touched or moved, as an agent's memory."""

from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import TensorSpec

from modpush._checks import check_spec_has, read_key
from modpush._transforms import DescribedTransform, add_unbounded
from modpush._validation import checked_arguments
from modpush.geometry.frames import Frame, rotate, wrap_angle
from modpush.mdp.action_frame import ActionFrame

HISTORY_STEPS = 8
"""Number of steps that `PushHistory` holds."""
HISTORY_VALUES = 10
"""Number of values of a step: tool tip (x, y), action (dx, dy), motion of tip and of object (x, y) each,
turn of the object, and contact."""

_MOVED = 5e-4  # shortest motion of an object that counts without a contact: it slides on [m]


class PushHistory(DescribedTransform):
    """Writes what the object did in the last `HISTORY_STEPS` steps in which it was touched or moved.

    From it follows what no image shows: an object turns about its centre of mass, and slides on after a
    push by the less the more friction it has. Steps without contact and motion are left out, so that the
    memory lasts while the tool goes around the object. At the beginning of an episode it is zeros.
    All vectors are in the object's frame at the beginning of their step, and so stay with the object as
    it turns. The entry `history` of the observation reads it in the agent's frame.

    Put it after `ActionFrame`, which has to have given back the agent's action.

    Args:
        frame: The axes in which the agent acts: `"object"`, `"path"` or `"base"`.
        action_key: Read, `[..., 3]` (dx, dy, dyaw) in [-1, 1].
        object_pose_key: Read before and after the step, `[..., 3]` (x, y, yaw) [m, rad], base frame.
        ee_pose_key: Pose of the tool's tip, read in the same way.
        object_contact_key: Read after the step, `[..., 1]` bool.
        subgoal_key: Read before the step for `"path"`, `[..., 2]` [m], base frame.
        history_key: Written and read back at each step, `[..., 8, 10]` float32, newest first: tip (x, y)
            from the object's centre before the step [m], action (dx, dy), motion of the tip (x, y) and of
            the object (x, y) [m], turn of the object [rad], and 1 for contact, else 0.

    Raises:
        KeyError: If a key that is read is missing.
    """

    @checked_arguments
    def __init__(
        self,
        frame: Frame = "base",
        *,
        action_key: NestedKey = "action",
        object_pose_key: NestedKey = "object_pose",
        ee_pose_key: NestedKey = "ee_pose",
        object_contact_key: NestedKey = "object_contact",
        subgoal_key: NestedKey = "subgoal",
        history_key: NestedKey = "history",
    ) -> None:
        super().__init__(
            in_keys=[object_pose_key, ee_pose_key, object_contact_key], out_keys=[history_key]
        )
        self._frame = ActionFrame(
            frame, action_key=action_key, object_pose_key=object_pose_key, subgoal_key=subgoal_key
        )
        self.object_pose_key, self.ee_pose_key = object_pose_key, ee_pose_key
        self.object_contact_key, self.history_key = object_contact_key, history_key

    def describe(self) -> dict[str, Any]:
        """Number of steps, and the shortest motion that counts without a contact [m]."""
        return {"history": {"steps": HISTORY_STEPS, "moved": _MOVED}}

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        # TorchRL puts back the old values of scenes that are not being reset.
        pose = read_key(tensordict_reset, self.object_pose_key, 3)
        shape = (*pose.shape[:-1], HISTORY_STEPS, HISTORY_VALUES)
        empty = torch.zeros(shape, dtype=torch.float32, device=pose.device)
        return tensordict_reset.set(self.history_key, empty)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        history = read_key(tensordict, self.history_key, HISTORY_STEPS, HISTORY_VALUES)
        newest, counts = self._record(tensordict, next_tensordict)
        moved_on = torch.cat([newest.unsqueeze(-2), history[..., :-1, :]], -2)
        kept = torch.where(counts.unsqueeze(-1), moved_on, history)
        return next_tensordict.set(self.history_key, kept)

    def _record(self, before: TensorDictBase, after: TensorDictBase) -> tuple[Tensor, Tensor]:
        """Values of the step, `[..., 10]`, and whether it is to be remembered, `[..., 1]` bool."""
        pose, pose_after = (read_key(td, self.object_pose_key, 3) for td in (before, after))
        tip, tip_after = (read_key(td, self.ee_pose_key, 3) for td in (before, after))
        contact = read_key(after, self.object_contact_key, 1)
        motion = pose_after[..., :2] - pose[..., :2]
        vectors = (
            tip[..., :2] - pose[..., :2],
            self._frame.to_base(before)[..., :2],
            tip_after[..., :2] - tip[..., :2],
            motion,
        )
        turned = [rotate(vector, -pose[..., 2:]) for vector in vectors]
        turn = wrap_angle(pose_after[..., 2:] - pose[..., 2:])
        values = torch.cat([*turned, turn, contact.float()], -1)
        return values, contact | (motion.norm(dim=-1, keepdim=True) > _MOVED)

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Add the history."""
        check_spec_has(observation_spec, self.in_keys)
        add_unbounded(observation_spec, self.history_key, HISTORY_STEPS, HISTORY_VALUES)
        return observation_spec
