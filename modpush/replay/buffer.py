"""A replay buffer in one call, its state for a file without a pickle, and the keys of a transition."""

from collections.abc import Callable, Mapping
from typing import Any

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase, is_tensor_collection
from torchrl.data import (
    LazyMemmapStorage,
    LazyTensorStorage,
    RandomSampler,
    TensorDictReplayBuffer,
)
from torchrl.data.replay_buffers.samplers import Sampler
from torchrl.data.replay_buffers.storages import Storage, TensorStorage

from modpush._checks import check_instance, read_key
from modpush._types import Key
from modpush._validation import check_value, checked_arguments
from modpush.parts import find_part
from modpush.replay.attentive import SIMILARITIES, AttentiveSampler, Similarity
from modpush.replay.config import ReplayConfig
from modpush.replay.n_step import NStepTransform, forget_open_steps, n_step_transforms
from modpush.replay.prioritized import PrioritizedSampler

SamplerFactory = Callable[[ReplayConfig], Sampler]
"""Makes a sampler from the config."""


class _ReplayBuffer(TensorDictReplayBuffer):
    """Its methods also reach what is kept beside the storage.

    These are transitions that wait for their n-step returns, and batches prepared ahead.
    """

    def empty(self, empty_write_count: bool = True) -> None:
        self.synchronize()
        with self._futures_lock:
            self._clear_prefetch_queue_locked()
        super().empty(empty_write_count)
        forget_open_steps(self)

    def __setitem__(self, index: Any, value: Any) -> None:
        if isinstance(value, TensorDictBase) and n_step_transforms(self):
            read_key(value, "steps_to_next_obs")
        super().__setitem__(index, value)


@checked_arguments
def make_replay_buffer(
    config: ReplayConfig,
    *,
    sampler: str | Sampler | SamplerFactory | None = None,
    similarity: str | Similarity | None = None,
    **kwargs: Any,
) -> TensorDictReplayBuffer:
    """Build a replay buffer of transitions.

    Args:
        config: The buffer's settings.
        sampler: A name, "module:name", a sampler, or a callable that makes one from the config,
            in place of `config.sampler`.
        similarity: A name, "module:name" or a `Similarity`, in place of `config.similarity`.
        **kwargs: Further arguments of TorchRL's `TensorDictReplayBuffer`, such as `transform`.

    Returns:
        The buffer, empty. Its priority key is the loss's, `"td_error"`.

    Raises:
        ValueError: If a part cannot be found, or a similarity is given for another sampler than an
            attentive one.
        TypeError: If the sampler's callable returns no sampler.
    """
    buffer = _ReplayBuffer(
        storage=_make_storage(config),
        sampler=_make_sampler(config, sampler, similarity),
        batch_size=config.batch_size,
        prefetch=config.prefetch or None,
        priority_key="td_error",
        **kwargs,
    )
    if config.n_steps > 1:
        buffer.append_transform(NStepTransform(config.n_steps, config.gamma))
    return buffer


def update_priorities(
    buffer: TensorDictReplayBuffer,
    batch: TensorDictBase,
    result: TensorDictBase,
    key: NestedKey = "td_error",
) -> None:
    """Give a prioritized sampler the new priorities of a batch; other samplers ignore them.

    Args:
        buffer: The buffer from which the batch was sampled.
        batch: The sample, with its `"index"`, `[B]`.
        result: Result of `TQCUpdate`.
        key: Key of the priorities in the result, `[B]`, positive.

    Raises:
        KeyError: If a prioritized sampler is used and the result has no priorities.
    """
    ignoring = (Sampler.update_priority, AttentiveSampler.update_priority)
    if type(buffer.sampler).update_priority in ignoring:
        return
    priority = read_key(result, key)
    buffer.update_priority(read_key(batch, "index"), priority)


def buffer_state(buffer: TensorDictReplayBuffer) -> dict[str, Any]:
    """State of a buffer of `make_replay_buffer`, as plain data and tensors, which are not copies.

    Batches that were prepared ahead (`prefetch`) are left out.
    """
    buffer.synchronize()
    storage = buffer.storage
    if not isinstance(storage, TensorStorage):
        raise TypeError(f"buffer_state: no file can hold a {type(storage).__name__}.")
    contents = None
    if len(storage):
        rows = storage._storage[: len(storage)]
        contents = rows.to_dict() if is_tensor_collection(rows) else rows
    return {
        "length": len(storage),
        "contents": contents,
        "sampler": dict(buffer.sampler.state_dict()),
        "writer": buffer.writer.state_dict(),
        "waiting": [transform.waiting for transform in n_step_transforms(buffer)],
    }


def load_buffer_state(buffer: TensorDictReplayBuffer, state: dict[str, Any]) -> None:
    """Put an empty buffer of the same kind into a state of `buffer_state`."""
    storage, length = buffer.storage, state["length"]
    if length:
        rows = state["contents"]
        data = TensorDict(rows, batch_size=[length]) if isinstance(rows, dict) else rows
        storage.set(range(length), data, set_cursor=False)
        storage._len = length  # without a cursor it is not counted
    buffer.sampler.load_state_dict(state["sampler"])
    buffer.writer.load_state_dict(state["writer"])
    for transform, waiting in zip(n_step_transforms(buffer), state["waiting"], strict=True):
        transform.waiting = None if waiting is None else waiting.clone()


def _make_storage(config: ReplayConfig) -> Storage:
    storage = LazyTensorStorage if config.storage == "tensor" else LazyMemmapStorage
    return storage(config.capacity, device=torch.device(config.device))


def _make_sampler(
    config: ReplayConfig,
    sampler: str | Sampler | SamplerFactory | None,
    similarity: str | Similarity | None,
) -> Sampler:
    given = config.sampler if sampler is None else sampler
    made: Any = find_part("sampler", given, SAMPLERS)
    if not isinstance(made, Sampler):
        try:
            made = made(config)
        except TypeError as error:
            raise TypeError(
                f"make_replay_buffer: sampler must make a Sampler of a ReplayConfig, got {given!r}, "
                f"which raised: {error}"
            ) from error
    if not isinstance(made, Sampler):
        raise TypeError(
            "make_replay_buffer: sampler must be a TorchRL Sampler or make one from a ReplayConfig,"
            f" {given!r} made a {type(made).__name__}."
        )
    if similarity is not None:
        if not isinstance(made, AttentiveSampler):
            raise ValueError(
                "make_replay_buffer: similarity is for attentive samplers, got a "
                f"{type(made).__name__}."
            )
        made.similarity = find_part("similarity", similarity, SIMILARITIES)
    return made


def _attentive(config: ReplayConfig) -> AttentiveSampler:
    return AttentiveSampler(
        config.k,
        key=config.observation_key,
        similarity=config.similarity,
        num_queries=config.num_queries or 1,
    )


SAMPLERS: Mapping[str, SamplerFactory] = {
    "attentive": _attentive,
    "uniform": lambda config: RandomSampler(),
    "prioritized": lambda config: PrioritizedSampler(
        config.capacity, config.priority_alpha, config.priority_beta
    ),
}
"""Samplers by name."""


TRANSITION_KEYS: tuple[NestedKey, ...] = (
    "observation",
    "action",
    ("next", "observation"),
    ("next", "reward"),
    ("next", "done"),
    ("next", "terminated"),
)
"""Keys of a transition that an off-policy learner needs. All else that `make_push_env` emits is for the
environment itself, for metrics and for the log."""


class KeepTransition:
    """Keeps the keys of `TRANSITION_KEYS` in collected data, for a collector's `postproc`.

    The environment has to emit more, for instance `blocked_bits`, in which it remembers what was
    hidden: drop that after collection, not by a transform in the environment.

    Args:
        *extra: Further keys to keep, such as `"window"` and `("next", "window")`.
    """

    def __init__(self, *extra: NestedKey) -> None:
        for key in extra:
            check_value("extra", key, Key)
        self.keys = (*TRANSITION_KEYS, *extra)

    def __call__(self, data: TensorDictBase) -> TensorDictBase:
        """The same transitions with these keys only; a KeyError if one is missing."""
        check_instance("data", data, TensorDictBase)
        for key in self.keys:
            read_key(data, key)
        return data.select(*self.keys)
