"""`ActionDelay`: the environment executes actions of earlier steps."""

from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase
from torchrl.data import TensorSpec, Unbounded

from modpush._arguments import checked_arguments
from modpush._checks import check_span
from modpush._keys import check_spec_has, read_key
from modpush._transforms import DescribedTransform
from modpush._types import Seed, StepSpan
from modpush.mdp.history import of_age, with_newest
from modpush.mdp.random_stream import RandomStream

__all__ = ["ActionDelay"]

_ACTION_DIM = 3
_SENT = "_sent_actions"
"""Key under which the actions sent so far wait while the environment steps."""


class ActionDelay(DescribedTransform):
    """Lets the environment execute the action of some steps ago, as a robot behind a network would.

    The age is drawn anew in every step, so that an action may be executed twice or never. Before
    enough actions exist, the action is zero and the tool stands still. What is stored is the
    agent's action. Put it before `ActionFrame`, next to the environment: then actions are delayed in
    the base frame, as a command that has been sent no longer turns with the object.

    Args:
        steps: Lowest and highest age of the executed action, both included, or one age [control steps];
            0 is the present action.
        seed: Seed of the ages, see `RandomStream`.
        action_key: Read and handed on to the environment, `[..., 3]`.
        history_key: Written, handed on at each step and read back, `[..., highest age, 3]` float32: the
            actions of earlier steps, newest first.
        stream_key: Written, handed on at each step and read back, `[..., 1]` int64.
        object_pose_key: Read at a reset for the stream, `[..., 3]` (x, y, yaw) [m, rad].
        goal_position_key: Read at a reset for the stream, `[..., 2]` [m].

    Raises:
        ValueError: If the lowest age is more than the highest, or negative.
        KeyError: If a key that is read is missing.
    Source: MuJoCo Playground's `PandaRobotiqPushCube`, which draws the age in every step, too.
    """

    @checked_arguments
    def __init__(
        self,
        steps: StepSpan,
        *,
        seed: Seed = 0,
        action_key: NestedKey = "action",
        history_key: NestedKey = "action_history",
        stream_key: NestedKey = "action_delay_stream",
        object_pose_key: NestedKey = "object_pose",
        goal_position_key: NestedKey = "goal_position",
    ) -> None:
        check_span("ActionDelay: steps", steps)
        self.steps = steps
        self.action_key, self.history_key = action_key, history_key
        self._stream = RandomStream(stream_key, seed, object_pose_key, goal_position_key)
        super().__init__(
            in_keys=self._stream.in_keys,
            out_keys=[history_key, stream_key],
            in_keys_inv=[action_key],
            out_keys_inv=[action_key],
        )

    def describe(self) -> dict[str, Any]:
        """Lowest and highest age of the executed action."""
        return {"action_delay": {"steps": self.steps}}

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        # TorchRL puts back the old values of scenes that are not being reset.
        state = self._stream.begin(tensordict_reset)
        shape = (*state.shape[:-1], self.steps[1], _ACTION_DIM)
        history = torch.zeros(shape, dtype=torch.float32, device=state.device)
        return tensordict_reset.set(self.history_key, history)

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        action = read_key(tensordict, self.action_key, _ACTION_DIM)
        history = read_key(tensordict, self.history_key, self.steps[1], _ACTION_DIM)
        sent = with_newest(action, history, action.ndim - 1)
        state = read_key(tensordict, self._stream.key, 1)
        tensordict.set(_SENT, sent)
        age = self._stream.integer(state, *self.steps)
        return tensordict.set(self.action_key, of_age(sent, age))

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        # TorchRL hands the transforms the tensordict that the environment was stepped with.
        sent = tensordict.pop(_SENT)
        tensordict.set(self.action_key, sent[..., 0, :])
        self._stream.advance(tensordict, next_tensordict)
        return next_tensordict.set(self.history_key, sent[..., :-1, :])

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Add the earlier actions and the stream."""
        check_spec_has(observation_spec, self.in_keys)
        observation_spec[self.history_key] = Unbounded(
            (*observation_spec.shape, self.steps[1], _ACTION_DIM),
            dtype=torch.float32,
            device=observation_spec.device,
        )
        self._stream.add_spec(observation_spec)
        return observation_spec
