"""A replay buffer's state as tensors and plain data, which a file can hold without a pickle."""

from typing import Any

from tensordict import TensorDict, is_tensor_collection
from torchrl.data import TensorDictReplayBuffer
from torchrl.data.replay_buffers.storages import TensorStorage

from modpush.replay.n_step import n_step_transforms

__all__ = ["buffer_state", "load_buffer_state"]


def buffer_state(buffer: TensorDictReplayBuffer) -> dict[str, Any]:
    """State of a buffer of `make_replay_buffer`; tensors are those of the buffer, not copies.

    Batches that were prepared ahead (`prefetch`) are left out.

    Raises:
        TypeError: If the storage is of another kind than TorchRL's tensor storages.
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
