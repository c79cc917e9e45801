"""Actions and observations of earlier steps: `ActionDelay` and `ObservationDelay`."""

from collections.abc import Sequence
from typing import Annotated, Any

import torch
from annotated_types import MinLen
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import TensorSpec, Unbounded

from modpush._checks import check_spec_has, read_key
from modpush._transforms import DescribedTransform
from modpush._types import Seed, StepSpan
from modpush._validation import checked_arguments
from modpush.mdp.noise import RandomStream


def of_age(values: Tensor, age: Tensor) -> Tensor:
    """The value of an age `[*B, 1]` [steps] in each scene, of values `[*B, n, *size]`, newest first."""
    lead = age.ndim - 1
    flat = values.flatten(0, lead - 1) if lead > 1 else values
    chosen = flat[torch.arange(len(flat), device=age.device), age.reshape(-1)]
    return chosen.reshape(*age.shape[:-1], *values.shape[lead + 1 :])


_ACTION_DIM = 3
_SENT = "_sent_actions"
"""Key under which the actions sent so far wait while the environment steps."""


class ActionDelay(DescribedTransform):
    """Lets the environment execute the action of some steps ago, as a robot behind a network would.

    The age is drawn in every step, so that an action may be executed twice or never. Before
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
        sent = torch.cat([action.unsqueeze(-2), history], -2)
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


class ObservationDelay(DescribedTransform):
    """Writes entries as they were some steps ago, beside the present ones.

    All entries have the same age, which is drawn in every step, so that a measurement may
    arrive twice or never. Before enough steps were taken they are those of the reset. The true state
    stays where it was, for reward, success and metrics; transforms that compute what the policy sees
    read the delayed entries by their `<name>_key` arguments.

    An image of 256 x 256 float32 takes 0.26 MB in the tensordict for each step of the highest age.

    Args:
        steps: Lowest and highest age, both included, or one age [control steps]; 0 is the present.
        in_keys: Entries that are read, of any shape.
        out_keys: Keys under which they are written, one for each; a key may stand in both.
        seed: Seed of the ages, see `RandomStream`.
        history_keys: Written, handed on at each step and read back, `[..., highest age, *]`, one for
            each: the entries of earlier steps, newest first. By default
            `("observation_history", "0")` and so on.
        stream_key: Written, handed on at each step and read back, `[..., 1]` int64.
        object_pose_key: Read at a reset for the stream, `[..., 3]` (x, y, yaw) [m, rad].
        goal_position_key: Read at a reset for the stream, `[..., 2]` [m].

    Raises:
        ValueError: If the lowest age is more than the highest, or negative, or there is another number
            of keys to write than to read.
        KeyError: If a key that is read is missing.
    Source: MuJoCo Playground's `PandaRobotiqPushCube`, which draws the age in every step, too.
    """

    @checked_arguments
    def __init__(
        self,
        steps: StepSpan,
        *,
        in_keys: Annotated[Sequence[NestedKey], MinLen(1)],
        out_keys: Annotated[Sequence[NestedKey], MinLen(1)],
        seed: Seed = 0,
        history_keys: Sequence[NestedKey] | None = None,
        stream_key: NestedKey = "observation_delay_stream",
        object_pose_key: NestedKey = "object_pose",
        goal_position_key: NestedKey = "goal_position",
    ) -> None:
        self.steps = steps
        if history_keys is None:
            history_keys = [("observation_history", str(i)) for i in range(len(in_keys))]
        if not len(in_keys) == len(out_keys) == len(history_keys):
            raise ValueError(
                "ObservationDelay: out_keys and history_keys must be as many as in_keys, got "
                f"{len(out_keys)} and {len(history_keys)} for {len(in_keys)}."
            )
        self._keys = list(zip(in_keys, out_keys, history_keys, strict=True))
        self._stream = RandomStream(stream_key, seed, object_pose_key, goal_position_key)
        super().__init__(
            in_keys=list(dict.fromkeys([*in_keys, *self._stream.in_keys])),
            out_keys=[*out_keys, *history_keys, stream_key],
        )

    def describe(self) -> dict[str, Any]:
        """Lowest and highest age, and the entries that are delayed."""
        names = [key if isinstance(key, str) else "/".join(key) for _, key, _ in self._keys]
        return {"observation_delay": {"steps": self.steps, "entries": names}}

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        # TorchRL puts back the old values of scenes that are not being reset.
        lead = self._stream.begin(tensordict_reset).ndim - 1
        for source, target, past in self._keys:
            value = read_key(tensordict_reset, source)
            tensordict_reset.set(target, value)
            history = value.unsqueeze(lead).repeat_interleave(self.steps[1], lead)
            tensordict_reset.set(past, history)
        return tensordict_reset

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        state = self._stream.advance(tensordict, next_tensordict)
        age = self._stream.integer(state, *self.steps)
        for source, target, past in self._keys:
            self._write(next_tensordict, source, target, past, read_key(tensordict, past), age)
        return next_tensordict

    def _write(
        self,
        tensordict: TensorDictBase,
        source: NestedKey,
        target: NestedKey,
        past: NestedKey,
        history: Tensor,
        age: Tensor,
    ) -> None:
        lead = age.ndim - 1
        newest = read_key(tensordict, source).unsqueeze(lead)
        values = torch.cat([newest, history], lead)
        tensordict.set(target, of_age(values, age))
        tensordict.set(past, values.narrow(lead, 0, self.steps[1]))

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Add the delayed entries, their histories and the stream."""
        check_spec_has(observation_spec, self.in_keys)
        lead = len(observation_spec.shape)
        for source, target, past in self._keys:
            spec = observation_spec[source].clone()
            shape = (*spec.shape[:lead], self.steps[1], *spec.shape[lead:])
            observation_spec[target] = spec
            observation_spec[past] = spec.unsqueeze(lead).expand(shape).clone()
        self._stream.add_spec(observation_spec)
        return observation_spec
