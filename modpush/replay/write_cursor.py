"""`WriteCursor`: which entries of a storage were written last."""

import torch
from torch import Tensor
from torchrl.data.replay_buffers.storages import Storage

from modpush.replay.storage_access import valid_shape

__all__ = ["WriteCursor"]


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
            count: How many; None for one row of the storage, which is one entry if it has one
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
