"""A storage that keeps each observation once.

Except at the end of an episode, a transition's next observation is the observation of a later
transition. So each entry keeps the index of that entry instead of a second copy. Next observations
without such an entry (the end of an episode, the newest transition, a successor that is overwritten
first) go to a side table.
"""

from collections import OrderedDict
from collections.abc import Sequence
from copy import deepcopy
from multiprocessing.context import get_spawning_popen
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.utils import NestedKey, unravel_key
from torch import Tensor
from torchrl.data import LazyTensorStorage
from torchrl.data.replay_buffers.checkpointers import StorageCheckpointerBase

from modpush._arguments import checked_arguments
from modpush._checks import check_instance
from modpush._state import read_state, write_state
from modpush._types import Count, Device
from modpush.files import reading

__all__ = ["CompactStorage"]

# How many entries may wait for their successor to be written. Older ones stay in the side table.
_MAX_WAITING = 4096
_NONE = -1
_FILE, _KIND, _VERSION = "storage.safetensors", "modpush.CompactStorage", 1


class _Checkpointer(StorageCheckpointerBase):
    """Writes one sealed file; TorchRL's own would unpickle what it finds beside its tensors."""

    def dumps(self, storage: "CompactStorage", path: str | Path) -> None:
        if not storage.initialized:
            raise RuntimeError("CompactStorage: an empty storage cannot be saved.")
        contents = storage._storage[: len(storage)].to_dict()
        state = {"length": len(storage), "contents": contents, "links": storage.links_state()}
        write_state(Path(path) / _FILE, state, _KIND, _VERSION)

    def loads(self, storage: "CompactStorage", path: str | Path) -> None:
        with reading(Path(path) / _FILE, _KIND):
            state = read_state(Path(path) / _FILE, _KIND, _VERSION)
            data = TensorDict(state["contents"], batch_size=[state["length"]])
            storage.load_contents(data, state["links"])


class CompactStorage(LazyTensorStorage):
    """A `LazyTensorStorage` of transitions that stores each observation once.

    It returns exactly what was written, to the bit: entries are linked only where the
    observation that is written equals a next observation written before, whatever the layout of
    the batches (several environments, whole trajectories, n-step transitions).

    Two 4-byte links take the place of the second observation. Writing costs a few microseconds a
    row on top; reading costs one more gather. Entries are changed by `buffer[index] = transitions`;
    `set_at_`, `set_` and `update_` do so in buffers of `make_replay_buffer`, but in TorchRL's own
    buffers must not be used for the keys below. It has one dimension and lives in one process.
    `TensorDictReplayBuffer` stores an `"index"` of 8 bytes beside each transition unless it is given
    TorchRL's plain `RoundRobinWriter`; samples carry their index either way.

    Args:
        max_size: Capacity in transitions.
        keys: Observation keys; each is expected under `("next", key)`, too.
        device: Device of the data.
    """

    _default_checkpointer = _Checkpointer

    @checked_arguments
    def __init__(
        self,
        max_size: Count,
        *,
        keys: Sequence[NestedKey] = ("observation",),
        device: torch.device | Device = "cpu",
    ) -> None:
        super().__init__(max_size, device=device)
        self.keys = [unravel_key(key) for key in keys]
        self._next_keys = [unravel_key(("next", key)) for key in self.keys]
        self._reset_links()

    def _reset_links(self) -> None:
        # successor[i] >= 0 is the entry that holds i's next observation, -2 - r row r of the side
        # table; predecessor is its inverse.
        self._successor = torch.full((self.max_size,), _NONE, dtype=torch.int32, device="cpu")
        self._predecessor = self._successor.clone()
        self._side: list[Tensor] = []  # one [R, ...] per key
        self._free_rows: list[int] = []
        self._waiting: OrderedDict[bytes, int] = OrderedDict()  # next observation -> entry
        self._awaited: dict[int, bytes] = {}  # its inverse

    def set(
        self, cursor: int | Sequence[int] | slice | Tensor, data: Any, *, set_cursor: bool = True
    ) -> None:
        """Write transitions, `[n]` (or one, `[]`) at `cursor`."""
        if isinstance(data, list):
            data = torch.stack(data)
        check_instance("CompactStorage", "data", data, TensorDictBase)
        single = data.ndim == 0
        rows = data.unsqueeze(0) if single else data
        slots = _all_slots(self)[cursor].reshape(-1) if single else _slots(cursor, self)
        self._check_keys(rows)
        if len(rows) > self.max_size:  # it would overwrite itself; only its end remains
            rows, slots = rows[-self.max_size :], slots[-self.max_size :]
            cursor, data = slots, rows
        if not set_cursor and len(slots.unique()) < len(slots):  # a link would have two owners
            raise ValueError("CompactStorage: indices must differ, got some of them twice.")
        if self.initialized:
            self._unlink(slots)
        super().set(cursor, data.exclude(*self._next_keys), set_cursor=set_cursor)
        self._link(slots, rows)

    def get(self, index: Any) -> TensorDictBase:
        """Read transitions with their next observations."""
        links = self._successor[: len(self)][_on_cpu(index)].long()
        if links.ndim == 0:  # an index of one entry would give views of what is stored
            return self.get(torch.tensor([int(index)], device="cpu"))[0]
        data = super().get(index).copy()
        for column, (key, next_key) in enumerate(zip(self.keys, self._next_keys, strict=True)):
            values = self._storage.get(key)[links.clamp_min(0).to(self._device_of(key))]
            beside = links < _NONE
            if beside.any():
                rows = (-2 - links[beside]).to(values.device)
                values[beside.to(values.device)] = self._side[column][rows]
            data.set(next_key, values)
        return data

    def nbytes(self) -> int:
        """Bytes allocated for data, links and the side table."""
        stored = [*self._storage.values(True, True), *self._side]
        links = (self._successor, self._predecessor)
        return sum(tensor.numel() * tensor.element_size() for tensor in (*stored, *links))

    def _check_keys(self, rows: TensorDictBase) -> None:
        for key in (*self.keys, *self._next_keys):
            if rows.get(key, None) is None:
                keys = sorted(map(str, rows.keys(True, True)))
                raise KeyError(f"CompactStorage: key {key!r} not found, the data has {keys}.")

    def _unlink(self, slots: Tensor) -> None:
        """Forget entries that are about to be overwritten, but keep the next observations they hold."""
        links = self._successor[slots].long()
        self._free_rows += (-2 - links[links < _NONE]).tolist()
        self._predecessor[links[links >= 0]] = _NONE
        self._successor[slots] = _NONE
        for slot in slots.tolist() if self._awaited else ():
            key = self._awaited.pop(slot, None)
            if key is not None:
                del self._waiting[key]
        survivors = self._predecessor[slots].long()
        orphaned = survivors >= 0
        if orphaned.any():
            values = [self._storage.get(key)[slots[orphaned]] for key in self.keys]
            self._set_beside(survivors[orphaned], values)
            self._predecessor[slots] = _NONE

    def _link(self, slots: Tensor, rows: TensorDictBase) -> None:
        """Connect fresh entries with those that wait for them."""
        heads = _row_bytes([rows.get(key) for key in self.keys])
        tails = _row_bytes([rows.get(key) for key in self._next_keys])
        pairs = []
        for slot, head, tail in zip(slots.tolist(), heads, tails, strict=True):
            waiting = self._waiting.pop(head, None)
            if waiting is not None:
                del self._awaited[waiting]
                pairs.append((waiting, slot))
            displaced = self._waiting.pop(tail, None)
            if displaced is not None:  # two entries with one next observation: the older gives way
                del self._awaited[displaced]
            self._waiting[tail] = slot
            self._awaited[slot] = tail
        while len(self._waiting) > _MAX_WAITING:
            _, slot = self._waiting.popitem(last=False)
            del self._awaited[slot]
        if pairs:
            before, after = torch.tensor(pairs, device="cpu").unbind(-1)
            links = self._successor[before].long()
            self._free_rows += (-2 - links[links < _NONE]).tolist()
            self._successor[before] = after.int()
            self._predecessor[after] = before.int()
        alone = self._successor[slots] == _NONE
        if alone.any():
            self._set_beside(slots[alone], [rows.get(key)[alone] for key in self._next_keys])

    def _set_beside(self, slots: Tensor, values: list[Tensor]) -> None:
        """Put next observations of the entries at `slots` into the side table."""
        if not self._side:
            self._side = [value.new_empty(0, *value.shape[1:]).to(self.device) for value in values]
        missing = len(slots) - len(self._free_rows)
        if missing > 0:
            size = len(self._side[0])
            grown = max(missing, size // 4, 64)
            self._side = [torch.cat([t, t.new_empty(grown, *t.shape[1:])]) for t in self._side]
            self._free_rows += range(size, size + grown)
        rows = torch.tensor([self._free_rows.pop() for _ in range(len(slots))], device="cpu")
        for table, value in zip(self._side, values, strict=True):
            table[rows.to(table.device)] = value.to(table.device)
        self._successor[slots] = (-2 - rows).int()

    def _device_of(self, key: NestedKey) -> torch.device:
        return self._storage.get(key).device

    def load_contents(self, data: TensorDictBase, links: dict[str, Any]) -> None:
        """Put what was stored, and its links, into this storage.

        Args:
            data: The entries without their next observations, `[n]`.
            links: From `links_state`.

        Raises:
            ValueError: If they are of a storage of another capacity.
        """
        self._check_capacity(links)
        super().set(range(len(data)), data, set_cursor=False)
        self._len = len(data)  # without a cursor it is not counted
        self._load_links(links)

    def links_state(self) -> dict[str, Any]:
        """The links and the side table, decoupled from the storage."""
        return {
            "successor": self._successor.clone(),
            "predecessor": self._predecessor.clone(),
            "side": [table.clone() for table in self._side],
            "free_rows": torch.tensor(self._free_rows, dtype=torch.long, device="cpu"),
        }

    def _check_capacity(self, links: dict[str, Any]) -> None:
        if (given := len(links["successor"])) != self.max_size:
            raise ValueError(
                f"CompactStorage: the state must be of a storage of {self.max_size} transitions, as this "
                f"one, got {given}."
            )

    def _load_links(self, state: dict[str, Any]) -> None:
        self._reset_links()  # entries that waited for a successor keep their row in the side table
        self._successor.copy_(state["successor"])
        self._predecessor.copy_(state["predecessor"])
        self._side = [table.clone().to(self.device) for table in state["side"]]
        self._free_rows = state["free_rows"].tolist()

    def state_dict(self) -> dict[str, Any]:
        """The data and the links, decoupled from the storage."""
        return {**deepcopy(super().state_dict()), "links": self.links_state()}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restore the data and the links.

        Raises:
            ValueError: If they are of a storage of another capacity.
        """
        self._check_capacity(state_dict["links"])
        super().load_state_dict(state_dict)
        self._load_links(state_dict["links"])

    def _empty(self) -> None:
        super()._empty()
        self._reset_links()

    def __getstate__(self) -> dict[str, Any]:
        if get_spawning_popen() is not None:
            raise RuntimeError(
                "CompactStorage: cannot be shared between processes; use LazyTensorStorage or "
                "LazyMemmapStorage there."
            )
        return super().__getstate__()


def _on_cpu(index: Any) -> Any:
    if isinstance(index, tuple) and len(index) == 1:
        index = index[0]
    return index.cpu() if isinstance(index, Tensor) else index


def _slots(cursor: Any, storage: CompactStorage) -> Tensor:
    if isinstance(cursor, slice):
        return _all_slots(storage)[cursor]
    return torch.as_tensor(cursor, dtype=torch.long, device="cpu").reshape(-1)


def _all_slots(storage: CompactStorage) -> Tensor:
    return torch.arange(storage.max_size, device="cpu")


def _row_bytes(values: Sequence[Tensor]) -> list[bytes]:
    """Each row's bytes over all keys: rows are alike exactly if these are."""
    flat = [value.detach().reshape(len(value), -1).cpu().contiguous() for value in values]
    joined = torch.cat([value.view(torch.uint8) for value in flat], -1).numpy()
    return [row.tobytes() for row in joined]
