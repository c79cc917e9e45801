"""Access of the attentive sampler to a storage: single keys, distinct and newest entries."""

import numpy as np
import torch
from tensordict import is_tensor_collection
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data.replay_buffers.storages import Storage, TensorStorage


def valid_shape(storage: Storage) -> torch.Size:
    """Shape of the part that has been written."""
    return torch.Size([len(storage)]) if storage.ndim == 1 else storage.shape


def read_entries(storage: Storage, index: Tensor, key: NestedKey) -> Tensor:
    """One key of some entries, flattened to `[P, D]`; whole numbers (bytes) as floats.

    Args:
        storage: A storage of tensordicts.
        index: `[P, ndim]`.
        key: Key to read.

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
    seed = torch.randint(2**63 - 1, (), generator=generator, device="cpu")
    return torch.from_numpy(np.random.default_rng(int(seed)).choice(total, size, replace=False))


class WriteCursor:
    """The newest entries of a storage, and how long ago the others were written."""

    def __init__(self) -> None:
        self.last: int | None = None
        """First coordinate of the entry written last, for storages that keep no cursor."""
        self._restored = False
        self._outdated: int | None = None

    def note(self, index: Tensor) -> None:
        """Note where entries were written, `[n]` or `[n, ndim]`."""
        if index.numel():
            self.last = int(index[-1].reshape(-1)[0])
            self._restored = False

    def restore(self, last: int | None) -> None:
        """Take over `last` of another one. What a storage's cursor says is of before, until it moves."""
        self.last, self._restored, self._outdated = last, True, None

    def newest(self, storage: Storage, count: int | None) -> Tensor | None:
        """Index of the newest entries, the oldest of them first.

        Args:
            storage: The storage that was written to.
            count: Number of entries; None for one row of the storage, which is one entry if it has one
                dimension.

        Returns:
            `[count, ndim]`; None if nothing was written since the storage was filled or restored.
        """
        newest = self._row(storage)
        if newest is None:
            return None
        shape = valid_shape(storage)
        row = shape[1:].numel()
        count = self.num_newest(storage, count)
        back = torch.arange(count, device="cpu").flip(0)
        flat = (newest * row + row - 1 - back) % shape.numel()
        index = torch.stack(torch.unravel_index(flat, shape), -1)
        return index.to(getattr(storage, "device", None) or "cpu")

    def num_newest(self, storage: Storage, count: int | None) -> int:
        """Number of entries that `newest` returns of a storage that is not empty."""
        shape = valid_shape(storage)
        return min(count or shape[1:].numel(), shape.numel())

    def age(self, storage: Storage, row: Tensor) -> Tensor:
        """Age of rows along the first dimension, counted in writes; -1 if unknown."""
        newest = self._row(storage)
        if newest is None:
            return torch.full_like(row, -1)
        return (newest - row) % valid_shape(storage)[0]

    def _row(self, storage: Storage) -> int | None:
        cursor = storage._last_cursor_index  # shared between processes
        if cursor is None:
            return self.last
        if self._restored:
            self._outdated = int(cursor) if self._outdated is None else self._outdated
            if int(cursor) == self._outdated:
                return self.last
            self._restored = False
        return int(cursor)
