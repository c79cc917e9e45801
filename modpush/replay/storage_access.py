"""Reading single keys of a storage, and drawing distinct entries."""

import torch
from tensordict import is_tensor_collection
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data.replay_buffers.storages import Storage, TensorStorage

__all__ = ["draw_distinct", "read_entries", "valid_shape"]


def valid_shape(storage: Storage) -> torch.Size:
    """Shape of the part that has been written."""
    return torch.Size([len(storage)]) if storage.ndim == 1 else storage.shape


def read_entries(storage: Storage, index: Tensor, key: NestedKey) -> Tensor:
    """One key of some entries, flattened to `[P, D]`; whole numbers (bytes) as floats.

    Args:
        storage: A storage of tensordicts.
        index: `[P, ndim]`.
        key: What is read.

    Raises:
        TypeError: If the storage holds something else than tensordicts.
        KeyError: If there is no such key; the known ones are listed.
    """
    coordinates = tuple(index.unbind(-1))
    backing = getattr(storage, "_storage", None)
    column = None
    if isinstance(storage, TensorStorage) and backing is not None:
        if not is_tensor_collection(backing):
            raise TypeError(
                "AttentiveSampler: the storage must hold tensordicts, got "
                f"{type(backing).__name__}."
            )
        column = backing.get(key, None)  # spares gathering the other keys
        if is_tensor_collection(column):
            raise TypeError(
                f"AttentiveSampler: key {key!r} must be of one tensor, got a group of "
                f"{sorted(map(str, column.keys(True, True)))}."
            )
    if column is not None:
        if len(coordinates) == 1:
            values = column.index_select(0, coordinates[0])
        else:
            values = column[coordinates]
    else:
        entries = storage.get(coordinates[0] if len(coordinates) == 1 else coordinates)
        if not is_tensor_collection(entries):
            entries = torch.stack(list(entries))
        values = entries.get(key, None)
        if values is None:
            keys = sorted(map(str, entries.keys(True, True)))
            raise KeyError(f"AttentiveSampler: key {key!r} not found, the storage has {keys}.")
    values = values.reshape(len(index), -1)
    return values if values.is_floating_point() else values.float()


def draw_distinct(total: int, size: int, generator: torch.Generator | None) -> Tensor:
    """A uniform subset of `size` out of `range(total)`, in time that depends on `size` only."""
    if 2 * size > total:
        return torch.randperm(total, generator=generator, device="cpu")[:size]
    chosen = torch.empty(0, dtype=torch.long, device="cpu")
    while len(chosen) < size:
        # A few more than are missing and will collide; then seldom is there a second round.
        missing = size - len(chosen)
        draws = missing * total // (total - size) + missing // 8 + 8
        more = torch.randint(total, (draws,), generator=generator, device="cpu")
        chosen = torch.cat([chosen, more]).unique()
    if len(chosen) == size:
        return chosen
    # `unique` sorts: drop at random, or the largest would be drawn too seldom.
    return chosen[torch.randperm(len(chosen), generator=generator, device="cpu")[:size]]
