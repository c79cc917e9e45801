"""n-step returns: rewards are summed over several steps before the target bootstraps."""

from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import TensorDictReplayBuffer
from torchrl.envs.transforms import MultiStepTransform

from modpush._types import Count, Fraction
from modpush._validation import checked_arguments


class NStepTransform(MultiStepTransform):
    """Turns stretches of single transitions into n-step transitions, on their way into a buffer.

    An n-step transition holds the discounted sum of up to `n_steps` rewards, the observation and
    the flags (`done`, `terminated`, `truncated`) after the last of them, and their number under
    `"steps_to_next_obs"`, with which losses discount the bootstrapped value. It ends early where
    the episode does. TorchRL's `MultiStepTransform` does the sums, but leaves the flags of the
    *first* step, so that a target would bootstrap from a terminal state; it also stores three
    entries that no loss reads.

    The last `n_steps` transitions of each environment wait for those that follow. They are part of
    the transform's state. Where environments are reset without the end of an episode in the data,
    call `forget`, also after `empty` of a buffer that is not from `make_replay_buffer`. Transitions
    that have their n-step returns already, such as those of another buffer, are stored as they are.

    Args:
        n_steps: Number of rewards in a sum, >= 1.
        gamma: Discount factor per step.
    """

    @checked_arguments
    def __init__(self, n_steps: Count, gamma: Fraction) -> None:
        super().__init__(n_steps, gamma, done_keys=[])  # none is left as it is

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase | None:
        """`[num_envs, time]` or `[time]` to `[n]`, environment after environment within a step."""
        if "steps_to_next_obs" in tensordict.keys():
            return tensordict
        if tensordict.ndim not in (1, 2):
            raise ValueError(
                "NStepTransform: transitions must be [num_envs, time] or [time], got "
                f"{list(tensordict.shape)}."
            )
        result = super()._inv_call(tensordict)
        if result is None:
            return None
        result = result.exclude("gamma", "nonterminal", ("next", "original_reward"))
        return (result.transpose(0, 1) if result.ndim == 2 else result).reshape(-1)

    def forget(self) -> None:
        """Drop the transitions that wait for those that follow."""
        self._buffer = None

    @property
    def waiting(self) -> TensorDictBase | None:
        """The transitions that wait for those that follow, `[num_envs, time]`."""
        return self._buffer

    @waiting.setter
    def waiting(self, transitions: TensorDictBase | None) -> None:
        self._buffer = transitions

    def get_extra_state(self) -> dict[str, Any]:
        """The waiting transitions as plain data; part of `state_dict`."""
        if self._buffer is None:
            return {"shape": [], "waiting": {}}
        return {"shape": list(self._buffer.shape), "waiting": self._buffer.clone().to_dict()}

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Inverse of `get_extra_state`."""
        waiting = TensorDict(state["waiting"], batch_size=state["shape"]).clone()
        self._buffer = waiting if state["waiting"] else None


@checked_arguments
def extend_rollout(
    buffer: TensorDictReplayBuffer, transitions: TensorDictBase, num_envs: Count
) -> Tensor:
    """Store the transitions of several environments over some steps, whatever the buffer's `n_steps`.

    Args:
        buffer: From `make_replay_buffer`.
        transitions: `[T * num_envs]`, environment after environment within a step.
        num_envs: Number of environments.

    Returns:
        Where they were written; with n-step returns, up to `n_steps` per environment wait.

    Raises:
        ValueError: If the transitions are not as many for each environment.
    """
    if transitions.ndim != 1 or len(transitions) % num_envs:
        raise ValueError(
            f"extend_rollout: transitions must be [T * num_envs] for {num_envs} environments, got "
            f"{list(transitions.shape)}."
        )
    if n_step_transforms(buffer):
        # Copied: what waits must not change with the arrays that the transitions came from.
        transitions = transitions.reshape(-1, num_envs).transpose(0, 1).clone()
    return buffer.extend(transitions)


@checked_arguments
def forget_open_steps(buffer: TensorDictReplayBuffer) -> None:
    """Drop the transitions that wait for their n-step returns.

    Call it where environments are reset without the end of an episode in the data, or the return
    of one episode would hold rewards of the next.

    Args:
        buffer: From `make_replay_buffer`.
    """
    for transform in n_step_transforms(buffer):
        transform.forget()


def n_step_transforms(buffer: TensorDictReplayBuffer) -> list[NStepTransform]:
    """The transforms of a buffer that sum rewards."""
    transforms: torch.nn.Module | None = buffer.transform
    if transforms is None:
        return []
    return [part for part in transforms.modules() if isinstance(part, NStepTransform)]
