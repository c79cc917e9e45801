"""Attentive experience replay: train on transitions that resemble the present situation."""

import math
from pathlib import Path
from typing import Any

import torch
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data.replay_buffers.samplers import Sampler
from torchrl.data.replay_buffers.storages import Storage

from modpush._checks import check_instance, check_keys
from modpush._state import read_state, write_state
from modpush._types import Count, Finite, NonNegativeInteger
from modpush._validation import check_value, checked_arguments
from modpush.files import reading
from modpush.parts import find_part
from modpush.replay.similarity import SIMILARITIES, Similarity
from modpush.replay.storage_access import WriteCursor, draw_distinct, read_entries, valid_shape

Index = Tensor | tuple[Tensor, ...]
_STATE_FILE = "attentive_sampler.safetensors"
_KIND, _VERSION = "modpush.AttentiveSampler", 1


class AttentiveSampler(Sampler):
    """Draws `k` times the batch uniformly and keeps the entries most similar to the query.

    The query is the present state: what `set_query` was given, else the newest written entries.
    With `Q` queries the batch is split evenly between them (a remainder goes to queries drawn at
    random), and each chooses from candidates of its own. Only the candidates' observations are
    read, so that the cost does not grow with the storage.

    The newest entries are one per environment only if the buffer is extended step by step or with
    steps outermost, `[time, env].reshape(-1)`. Of `[env, time].reshape(-1)` they are all the last
    environment's: use a storage of two dimensions or `set_query` there.

    Works on any storage of tensordicts (`LazyTensorStorage`, `LazyMemmapStorage`, `ListStorage`,
    several dimensions, prefetching, several processes, `RayReplayBuffer`). Beside the index, a
    sample's info holds `"similarity"` `[batch]` and `"age"` `[batch]`, how many writes ago the
    entry was written (along the storage's first dimension).

    Args:
        k: Candidates per kept entry, >= 1; 1 is uniform sampling. TorchRL's replay schedulers may
            change it: `LinearScheduler(sampler, "k", 1.0, 10_000)`.
        key: The observation that is compared, flattened to `[*, D]`; bytes are compared as floats.
        similarity: `"cosine"`, `"negative_l2"`, `"module:name"`, or a callable
            `(candidates [Q, C, D], queries [Q, D]) -> [Q, C]`, larger is more alike.
        num_queries: Number of newest entries that are the default query. By default one, or in
            a storage of several dimensions the newest row, one entry per environment.
        candidate_replacement: Let a candidate be drawn twice, as in TorchRL's uniform sampling;
            the paper leaves it open. With `k = 4`, some 60 of a batch of 512 are then copies of others
            in a buffer of 8,000 entries, and one or none in the paper's million.

    Raises:
        ValueError: If an argument is out of range. In `sample`: if there are more candidates than
            entries, or NaN in them or in the query, or a query of another width.

    Source: paper Sec. IV-B; Sun et al. (2020), "Attentive Experience Replay".
    """

    @checked_arguments
    def __init__(
        self,
        k: float = 4,
        *,
        key: NestedKey = "observation",
        similarity: str | Similarity = "cosine",
        num_queries: Count | None = None,
        candidate_replacement: bool = True,
    ) -> None:
        super().__init__()
        self.k = k
        self.key = key
        self.similarity: Similarity = find_part("similarity", similarity, SIMILARITIES)
        self.num_queries = num_queries
        self.candidate_replacement = candidate_replacement
        self._query: Tensor | None = None
        self._cursor = WriteCursor()

    @property
    def k(self) -> float:
        """Candidates per kept entry."""
        return self._k

    @k.setter
    def k(self, value: float) -> None:
        self._k = _checked_k("k", value)

    def set_query(self, query: Tensor | None) -> None:
        """Set the present states, until the next call.

        Args:
            query: Observations `[Q, D]` or `[D]`, or None for the newest written ones.

        Raises:
            ValueError: If the query is empty, of more dimensions, or holds NaN.
        """
        if query is not None:
            check_instance("query", query, Tensor)
            if query.ndim not in (1, 2) or not query.numel():
                raise ValueError(
                    f"AttentiveSampler: query must be [Q, D] or [D], got {tuple(query.shape)}."
                )
            _check_no_nan(query, "query")
            query = query.detach().clone().reshape(-1, query.shape[-1])
        self._query = query

    def num_candidates(self, storage: Storage, batch_size: int) -> int:
        """Number of candidates that the next sample of this size draws, rounded up for each query."""
        if self._query is not None:
            num_queries = len(self._query)
        else:
            num_queries = self._cursor.num_newest(storage, self.num_queries)
        shares = self._shares(num_queries, batch_size)
        return sum(count * self._candidates_for(kept) for count, kept in shares)

    def can_sample(self, storage: Storage, batch_size: int) -> bool:
        """True if the storage holds enough candidates."""
        _check_batch_size(batch_size)
        return len(storage) > 0 and len(storage) >= self.num_candidates(storage, batch_size)

    def sample(self, storage: Storage, batch_size: int) -> tuple[Index, dict[str, Any]]:
        """Draw a batch.

        Args:
            storage: A storage of tensordicts.
            batch_size: Number of entries to draw.

        Returns:
            The index (a tuple of indices for several dimensions) and the info.
        """
        if len(storage) == 0:
            raise RuntimeError("Cannot sample from an empty storage.")
        self._check_enough(storage, batch_size)
        queries = self._queries(storage)
        if batch_size % len(queries):
            order = torch.randperm(len(queries), generator=storage._rng, device="cpu")
            queries = queries[order.to(queries.device)]
        shares = self._shares(len(queries), batch_size)
        # All at once, or two calls could draw the same entry although none is to be drawn twice.
        sizes = [count * self._candidates_for(kept) for count, kept in shares]
        drawn = self._draw(storage, sum(sizes)).split(sizes)
        parts, first = [], 0
        for (count, kept), candidates in zip(shares, drawn, strict=True):
            parts.append(self._choose(storage, candidates, queries[first : first + count], kept))
            first += count
        index = torch.cat([index for index, _ in parts])  # [batch, ndim]
        similarity = torch.cat([similarity for _, similarity in parts])
        info = {"similarity": similarity, "age": self._cursor.age(storage, index[:, 0])}
        return index[:, 0] if storage.ndim == 1 else index.unbind(-1), info

    def _shares(self, num_queries: int, batch_size: int) -> list[tuple[int, int]]:
        """Numbers of queries, and of entries that each of them keeps: those with one more come first.

        Queries without an entry, where there are more queries than entries, are left out.
        """
        share, remainder = divmod(batch_size, num_queries)
        shares = ((remainder, share + 1), (num_queries - remainder, share))
        return [(count, kept) for count, kept in shares if count and kept]

    def _candidates_for(self, kept: int) -> int:
        """Number of candidates of a query that keeps so many entries."""
        return math.ceil(self.k * kept)

    def _check_enough(self, storage: Storage, batch_size: int) -> None:
        if self.can_sample(storage, batch_size):
            return
        needed = self.num_candidates(storage, batch_size)
        rounded = needed != self.k * batch_size
        raise ValueError(
            f"AttentiveSampler: k * batch_size must be <= the entries stored, got "
            f"{self.k:g} * {batch_size}{f', rounded up to {needed},' if rounded else ''} "
            f"for {len(storage)} entries."
        )

    def _choose(
        self, storage: Storage, index: Tensor, queries: Tensor, share: int
    ) -> tuple[Tensor, Tensor]:
        """The `share` best of each query's candidates: `[Q * share, ndim]`, `[Q * share]`.

        The candidates' index is `[Q * C, ndim]`, one query's after the other's.
        """
        num_queries, width = queries.shape
        num_candidates = len(index) // num_queries
        candidates = read_entries(storage, index, self.key)
        if candidates.shape[-1] != width:
            raise ValueError(
                f"AttentiveSampler: the query is {width} wide, {self.key!r} is "
                f"{candidates.shape[-1]}."
            )
        candidates = candidates.view(num_queries, num_candidates, width)
        similarity = self.similarity(candidates, queries.to(candidates))
        _check_no_nan(similarity, f"the similarity to {self.key!r} of a stored entry")
        best = similarity.topk(share, dim=-1, sorted=False)
        offset = torch.arange(num_queries, device=index.device).unsqueeze(-1) * num_candidates
        return index[(best.indices + offset).flatten()], best.values.flatten()

    def _draw(self, storage: Storage, size: int) -> Tensor:
        """Uniform candidates, `[size, ndim]`."""
        if self.candidate_replacement:
            index = storage._rand_given_ndim(size)
            return index.unsqueeze(-1) if storage.ndim == 1 else torch.stack(index, -1)
        shape = valid_shape(storage)
        flat = draw_distinct(shape.numel(), size, storage._rng)
        index = torch.stack(torch.unravel_index(flat, shape), -1)
        return index.to(getattr(storage, "device", None) or "cpu")

    def _queries(self, storage: Storage) -> Tensor:
        """The present states, `[Q, D]`."""
        if self._query is not None:
            return self._query
        index = self._cursor.newest(storage, self.num_queries)
        if index is None:
            raise RuntimeError(
                "AttentiveSampler: there is no query yet: nothing was written since the storage "
                "was filled or restored. Call set_query first."
            )
        queries = read_entries(storage, index, self.key)
        _check_no_nan(queries, f"the query, {self.key!r} of the newest entries,")
        return queries

    def add(self, index: int | Tensor) -> None:
        """Note where the buffer wrote an entry."""
        index = index if isinstance(index, Tensor) else torch.tensor(index, device="cpu")
        self._cursor.note(index.reshape(1, -1))

    def extend(self, index: Tensor) -> None:
        """Note where the buffer wrote entries."""
        index = index if isinstance(index, Tensor) else torch.as_tensor(index, device="cpu")
        self._cursor.note(index)

    def update_priority(self, *args: Any, **kwargs: Any) -> None:
        """Do nothing: similarity is the only priority."""

    def _empty(self) -> None:
        self._cursor = WriteCursor()
        self._query = None

    def state_dict(self) -> dict[str, Any]:
        """K and query, as copies."""
        return {
            "k": self.k,
            "query": None if self._query is None else self._query.clone(),
            "newest": self._cursor.last,
        }

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Continue where the other sampler was.

        Raises:
            ValueError: If the state is that of another kind of sampler, or a value is malformed.
        """
        check_keys(state_dict, self.state_dict())
        k = check_value("k", state_dict["k"], Finite)
        newest = check_value("newest", state_dict["newest"], NonNegativeInteger | None)
        self.set_query(state_dict["query"])
        self.k = k
        self._cursor.restore(newest)

    def dumps(self, path: str | Path) -> None:
        """Write the state into a directory."""
        write_state(Path(path) / _STATE_FILE, self.state_dict(), _KIND, _VERSION)

    @checked_arguments
    def loads(self, path: str | Path) -> None:
        """Read the state from a directory.

        Raises:
            FileNotFoundError: If no attentive sampler was saved there.
            ValueError: If the file is damaged.
        """
        path = Path(path)
        if not (path / _STATE_FILE).exists():
            raise FileNotFoundError(
                f"AttentiveSampler: {path} holds no {_STATE_FILE}: the buffer was saved with "
                "another sampler. Load it with that one, or only its storage."
            )
        with reading(path / _STATE_FILE, _KIND):
            self.load_state_dict(read_state(path / _STATE_FILE, _KIND, _VERSION))

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}(k={self.k}, key={self.key!r}, "
            f"similarity={getattr(self.similarity, '__name__', self.similarity)})"
        )


def _check_batch_size(batch_size: int) -> None:
    if not isinstance(batch_size, int) or batch_size < 1:
        raise ValueError(
            f"AttentiveSampler: batch_size must be a whole number >= 1, got {batch_size!r}."
        )


def _checked_k(name: str, k: float) -> float:
    if not 1 <= k < math.inf:
        raise ValueError(f"AttentiveSampler: {name} must be >= 1, got {k}.")
    return k


def _check_no_nan(x: Tensor, what: str) -> None:
    # A sum is NaN if anything is, and costs a fifth of `isnan().any()`.
    if x.is_floating_point() and x.sum().isnan():
        rows = x.isnan().reshape(x.shape[0], -1).any(-1).nonzero().flatten().tolist()
        if rows:
            raise ValueError(
                f"AttentiveSampler: {what} must be finite, got NaN in rows {rows[:8]}."
            )
