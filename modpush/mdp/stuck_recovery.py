"""`StuckRecovery`: actions that free a policy which has come to rest before the goal."""

import math
from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase, TensorDictSequential
from torch import Tensor
from torchrl.data import Binary, Bounded, TensorSpec, Unbounded

from modpush._checks import check_spec_has, read_key
from modpush._transforms import DescribedTransform
from modpush._types import Count, Length
from modpush._validation import checked_arguments

# Turned by this angle again and again, directions spread evenly.
_GOLDEN_ANGLE = math.pi * (3 - math.sqrt(5))
# Where an object is wedged between two walls, four steps do not free it.
_LONGER, _LONGER_AFTER = 2, 3
# Tool and object (x, y) where they came to rest, steps at rest, steps left, recoveries so far.
_STATE = 7


class StuckRecovery(DescribedTransform):
    """Detects that tool and object have come to rest, and requests actions for some steps.

    A greedy policy whose action moves nothing, for instance with the tool against an obstacle, sees the
    same observation again and takes the same action until the time limit. After `patience`
    steps in which neither tool nor object has gone farther than `tolerance`, this transform requests an
    action at full speed for `duration` steps: the first time along -x and turning to the left; each
    further time in an episode turned by the golden angle and turning the other way. After every third
    recovery of an episode the next ones take two steps more. Nothing about it is random. In the path's
    frame -x leads back from the object.

    The transform only writes the requested action; `recovering(policy)` is the policy that follows it.
    It can be appended to any environment whose actions are a motion in x and y and a turn.

    All that it remembers is in the tensordict, so that partial resets, copies and workers are right
    by construction.

    Args:
        patience: Number of steps at rest before a recovery.
        duration: Number of steps of each of the first three recoveries of an episode.
        tolerance: Largest motion of tool and object along x or y at rest [m].
        object_pose_key: Read, `[..., 3]` (x, y, yaw) [m, rad].
        ee_pose_key: Read, `[..., 3]` (x, y, yaw) of the tool's tip [m, rad].
        action_key: Written, `[..., 3]` float32 in [-1, 1]: the action to take, 0 outside a recovery.
        active_key: Written, `[..., 1]` bool, True in a recovery.
        state_key: Written, handed on at each step and read back, `[..., 7]` float32.

    Raises:
        ValueError: If a number is out of its range.
        KeyError: If a key that is read is missing.
    """

    @checked_arguments
    def __init__(
        self,
        patience: Count = 4,
        duration: Count = 4,
        tolerance: Length = 0.01,
        *,
        object_pose_key: NestedKey = "object_pose",
        ee_pose_key: NestedKey = "ee_pose",
        action_key: NestedKey = "recovery_action",
        active_key: NestedKey = "recovering",
        state_key: NestedKey = "recovery_state",
    ) -> None:
        self.patience, self.duration, self.tolerance = patience, duration, tolerance
        self.action_key, self.active_key, self.state_key = action_key, active_key, state_key
        super().__init__(
            in_keys=[ee_pose_key, object_pose_key], out_keys=[action_key, active_key, state_key]
        )

    def describe(self) -> dict[str, Any]:
        """Conditions of a recovery, and its length."""
        names = ("patience", "duration", "tolerance")
        return {"recovery": {name: getattr(self, name) for name in names}}

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        # TorchRL puts back the old values of scenes that are not being reset.
        where = self._where(tensordict_reset)
        rest = torch.zeros_like(where[..., :3])
        return self._write(tensordict_reset, torch.cat([where, rest], -1))

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        state = read_key(tensordict, self.state_key, _STATE)
        anchor, (still, left, times) = state[..., :4], state[..., 4:].unbind(-1)
        where = self._where(next_tensordict)
        at_rest = ((where - anchor).abs() <= self.tolerance).all(-1)
        still = torch.where(at_rest, still + 1, 0)
        left = (left - 1).clamp_min(0)
        begins = (still >= self.patience) & (left == 0)
        left = torch.where(begins, self.duration + _LONGER * (times // _LONGER_AFTER), left)
        anchor = torch.where(at_rest[..., None], anchor, where)
        counts = torch.stack([still, left, times + begins], -1)
        return self._write(next_tensordict, torch.cat([anchor, counts], -1))

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Compute the entries under `"next"` of stored transitions again, from the state at their root.

        Raises:
            KeyError: If `"next"` or the state is not stored with the transitions.
        """
        self._step(tensordict, read_key(tensordict, "next"))
        return tensordict

    def _where(self, tensordict: TensorDictBase) -> Tensor:
        poses = [read_key(tensordict, key, 3) for key in self.in_keys]
        return torch.cat([pose[..., :2].float() for pose in poses], -1)

    def _write(self, tensordict: TensorDictBase, state: Tensor) -> TensorDictBase:
        left, times = state[..., 5], state[..., 6]
        angle = math.pi + (times - 1) * _GOLDEN_ANGLE
        turn = 2.0 * (times % 2) - 1.0
        action = torch.stack([angle.cos(), angle.sin(), turn], -1)
        active = (left > 0)[..., None]
        tensordict.set(self.action_key, action * active)
        tensordict.set(self.active_key, active)
        return tensordict.set(self.state_key, state)

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Add what is written."""
        check_spec_has(observation_spec, self.in_keys)
        shape, device = observation_spec.shape, observation_spec.device
        observation_spec[self.action_key] = Bounded(
            -1, 1, (*shape, 3), device=device, dtype=torch.float32
        )
        observation_spec[self.active_key] = Binary(1, (*shape, 1), device=device, dtype=torch.bool)
        observation_spec[self.state_key] = Unbounded(
            (*shape, _STATE), device=device, dtype=torch.float32
        )
        return observation_spec


@checked_arguments
def recovering(
    policy: TensorDictModuleBase,
    *,
    policy_action_key: NestedKey = "action",
    action_key: NestedKey = "recovery_action",
    active_key: NestedKey = "recovering",
) -> TensorDictSequential:
    """A policy that takes the actions that `StuckRecovery` requests, and its own otherwise.

    Args:
        policy: The policy, which writes `policy_action_key`, `[..., 3]`.
        policy_action_key: Key of its action, read and written.
        action_key: Read, `[..., 3]`, as `StuckRecovery` writes it.
        active_key: Read, `[..., 1]` bool, as `StuckRecovery` writes it.

    Raises:
        ValueError: If the policy is not a TensorDict module.
    """
    keys = [policy_action_key, action_key, active_key]
    chosen = TensorDictModule(_choose, in_keys=keys, out_keys=[policy_action_key])
    return TensorDictSequential(policy, chosen)


def _choose(action: Tensor, recovery: Tensor, active: Tensor) -> Tensor:
    return torch.where(active, recovery, action)
