"""Attentive experience replay: train on transitions that resemble the present situation."""

import math
from collections.abc import Callable
from typing import Any

import torch
from tensordict import is_tensor_collection
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data.replay_buffers.samplers import Sampler
from torchrl.data.replay_buffers.storages import Storage, TensorStorage

from modpush._checks import check_instance, check_keys, read_key
from modpush._state import SavedState
from modpush._types import Count, Finite, NonNegativeInteger
from modpush._validation import check_value, checked_arguments
from modpush.parts import find_part

Similarity = Callable[[Tensor, Tensor], Tensor]
"""`(candidates [Q, C, D], queries [Q, D]) -> similarity [Q, C]`, larger is more alike."""


def cosine(candidates: Tensor, queries: Tensor) -> Tensor:
    """Cosine of the angle between each candidate and its query.

    Args:
        candidates: `[Q, C, D]`.
        queries: `[Q, D]`.

    Returns:
        Values in [-1, 1], `[Q, C]`; 0 where a vector is zero.

    Raises:
        TypeError: If one of them is not a tensor.
        ValueError: If the shapes do not belong together.
    Source: Sun et al. (2020), "Attentive Experience Replay".
    """
    _check_pairs(candidates, queries)
    dot = torch.matmul(candidates, queries.unsqueeze(-1)).squeeze(-1)
    # Row norms through einsum: a third of the time of `vector_norm` on a strided batch.
    norms = torch.linalg.vecdot(candidates, candidates).sqrt_()
    norms = norms * torch.linalg.vector_norm(queries, dim=-1, keepdim=True)
    return dot / norms.clamp_min(torch.finfo(norms.dtype).tiny)


def negative_l2(candidates: Tensor, queries: Tensor) -> Tensor:
    """Minus the Euclidean distance between each candidate and its query.

    Args:
        candidates: `[Q, C, D]`.
        queries: `[Q, D]`.

    Returns:
        Values <= 0, `[Q, C]`.

    Raises:
        TypeError: If one of them is not a tensor.
        ValueError: If the shapes do not belong together.
    """
    _check_pairs(candidates, queries)
    return -torch.linalg.vector_norm(candidates - queries.unsqueeze(-2), dim=-1)


def _check_pairs(candidates: Tensor, queries: Tensor) -> None:
    check_instance("candidates", candidates, Tensor)
    check_instance("queries", queries, Tensor)
    if candidates.ndim != 3:
        raise ValueError(f"candidates must be [Q, C, D], got {list(candidates.shape)}.")
    if queries.shape != (candidates.shape[0], candidates.shape[2]):
        raise ValueError(
            f"queries must be [Q, D] for candidates [Q, C, D] = {list(candidates.shape)}, got "
            f"{list(queries.shape)}."
        )


SIMILARITIES: dict[str, Similarity] = {"cosine": cosine, "negative_l2": negative_l2}
"""The similarities that can be asked for by name."""


class AttentiveSampler(SavedState, Sampler):
    """Draws `k` times the batch uniformly and keeps the entries most similar to the query.

    The query is the present state: what `set_query` was given, else the newest written entries. With `Q`
    queries the batch is split evenly between them (a remainder goes to queries drawn at random), and each
    chooses from candidates of its own. Only the candidates' observations are read, so that the cost does
    not grow with the storage. Candidates are drawn with replacement, as in TorchRL's uniform sampling: of
    a batch of 512 some 60 are then copies of others in a buffer of 8,000 entries, and one or none in the
    paper's million.

    The newest entries are one per environment only if the buffer is extended step by step or with steps
    outermost, `[time, env].reshape(-1)`. Of `[env, time].reshape(-1)` they are the last environment's.

    Works on TorchRL's tensor storages of tensordicts with one dimension (`LazyTensorStorage`,
    `LazyMemmapStorage`). Beside the index, a sample's info holds `"similarity"` `[batch]` and `"age"`
    `[batch]`, how many writes ago the entry was written.

    Args:
        k: Candidates per kept entry, >= 1; 1 is uniform sampling. TorchRL's replay schedulers may
            change it: `LinearScheduler(sampler, "k", 1.0, 10_000)`.
        key: The observation that is compared, flattened to `[*, D]`; bytes are compared as floats.
        similarity: `"cosine"`, `"negative_l2"`, `"module:name"`, or a callable
            `(candidates [Q, C, D], queries [Q, D]) -> [Q, C]`, larger is more alike.
        num_queries: Number of newest entries that are the default query.

    Raises:
        TypeError: In `sample`, if the storage is of another kind.
        ValueError: If an argument is out of range. In `sample`: if there are more candidates than
            entries, or NaN in them or in the query, or a query of another width.

    Source: paper Sec. IV-B; Sun et al. (2020), "Attentive Experience Replay".
    """

    state_file = "attentive_sampler.safetensors"

    @checked_arguments
    def __init__(
        self,
        k: float = 4,
        *,
        key: NestedKey = "observation",
        similarity: str | Similarity = "cosine",
        num_queries: Count = 1,
    ) -> None:
        super().__init__()
        self.k = k
        self.key = key
        self.similarity: Similarity = find_part("similarity", similarity, SIMILARITIES)
        self.num_queries = num_queries
        self._empty()

    def _empty(self) -> None:
        self._query: Tensor | None = None
        self._newest: int | None = None  # index of the entry that was written last

    @property
    def k(self) -> float:
        """Candidates per kept entry."""
        return self._k

    @k.setter
    def k(self, value: float) -> None:
        if not 1 <= value < math.inf:
            raise ValueError(f"AttentiveSampler: k must be >= 1, got {value}.")
        self._k = value

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
        newest = min(self.num_queries, len(storage))
        shares = self._shares(newest if self._query is None else len(self._query), batch_size)
        return sum(count * math.ceil(self.k * kept) for count, kept in shares)

    def can_sample(self, storage: Storage, batch_size: int) -> bool:
        """True if the storage holds enough candidates."""
        return len(storage) > 0 and len(storage) >= self.num_candidates(storage, batch_size)

    def sample(self, storage: Storage, batch_size: int) -> tuple[Tensor, dict[str, Any]]:
        """Draw a batch.

        Args:
            storage: A storage of tensordicts.
            batch_size: Number of entries to draw.

        Returns:
            The index (a tuple of indices for several dimensions) and the info.
        """
        if len(storage) == 0:
            raise RuntimeError("Cannot sample from an empty storage.")
        needed = self.num_candidates(storage, batch_size)
        if needed > len(storage):
            raise ValueError(
                f"AttentiveSampler: k * batch_size must be <= the entries stored, got {self.k:g} * "
                f"{batch_size}, rounded up to {needed}, for {len(storage)} entries."
            )
        queries = self._queries(storage)
        if batch_size % len(queries):
            order = torch.randperm(len(queries), generator=storage._rng, device="cpu")
            queries = queries[order.to(queries.device)]
        shares = self._shares(len(queries), batch_size)
        sizes = [count * math.ceil(self.k * kept) for count, kept in shares]
        drawn = self._draw(storage, sum(sizes)).split(sizes)
        parts, first = [], 0
        for (count, kept), candidates in zip(shares, drawn, strict=True):
            parts.append(self._choose(storage, candidates, queries[first : first + count], kept))
            first += count
        index = torch.cat([index for index, _ in parts])
        age = torch.full_like(index, -1)
        if self._newest is not None:
            age = (self._newest - index) % len(storage)
        return index, {"similarity": torch.cat([value for _, value in parts]), "age": age}

    @staticmethod
    def _shares(num_queries: int, batch_size: int) -> list[tuple[int, int]]:
        """Numbers of queries, and of entries that each of them keeps: those with one more come first.

        Queries without an entry, where there are more queries than entries, are left out.
        """
        share, remainder = divmod(batch_size, num_queries)
        shares = ((remainder, share + 1), (num_queries - remainder, share))
        return [(count, kept) for count, kept in shares if count and kept]

    def _choose(
        self, storage: Storage, index: Tensor, queries: Tensor, share: int
    ) -> tuple[Tensor, Tensor]:
        """Index and similarity of the `share` best of each query's candidates, `[Q * share]`.

        The candidates' index is `[Q * C]`, one query's after the other's.
        """
        num_queries, width = queries.shape
        candidates = self._read(storage, index)
        if candidates.shape[-1] != width:
            raise ValueError(
                f"AttentiveSampler: the query is {width} wide, {self.key!r} is "
                f"{candidates.shape[-1]}."
            )
        candidates = candidates.view(num_queries, -1, width)
        similarity = self.similarity(candidates, queries.to(candidates))
        _check_no_nan(similarity, f"the similarity to {self.key!r} of a stored entry")
        best = similarity.topk(share, dim=-1, sorted=False)
        offset = torch.arange(num_queries, device=index.device).unsqueeze(-1) * candidates.shape[1]
        return index[(best.indices + offset).flatten()], best.values.flatten()

    def _draw(self, storage: Storage, size: int) -> Tensor:
        """Uniform candidates, `[size]`."""
        return storage._rand_given_ndim(size)

    def _queries(self, storage: Storage) -> Tensor:
        """The present states, `[Q, D]`."""
        if self._query is not None:
            return self._query
        if self._newest is None:
            raise RuntimeError(
                "AttentiveSampler: there is no query yet: nothing was written since the storage "
                "was filled or restored. Call set_query first."
            )
        back = torch.arange(min(self.num_queries, len(storage)), device="cpu").flip(0)
        queries = self._read(storage, (self._newest - back) % len(storage))
        _check_no_nan(queries, f"the query, {self.key!r} of the newest entries,")
        return queries

    def _read(self, storage: Storage, index: Tensor) -> Tensor:
        """The compared observations of some entries `[P]`, flattened to `[P, D]`; bytes as floats."""
        entries = storage._storage if isinstance(storage, TensorStorage) else None
        if not is_tensor_collection(entries):
            kind = type(storage).__name__
            raise TypeError(
                f"AttentiveSampler: the storage must be a TensorStorage of tensordicts, got {kind}."
            )
        column = read_key(entries, self.key)  # spares gathering the other keys
        check_instance(repr(self.key), column, Tensor)
        values = column.index_select(0, index.to(column.device)).flatten(1)
        return values if values.is_floating_point() else values.float()

    def add(self, index: int | Tensor) -> None:
        """Note where the buffer wrote an entry."""
        self.extend(torch.as_tensor(index, device="cpu").reshape(-1))

    def extend(self, index: Tensor) -> None:
        """Note where the buffer wrote entries, `[n]`.

        Raises:
            ValueError: If the storage has several dimensions.
        """
        if getattr(index, "ndim", 1) != 1:
            raise ValueError(
                f"AttentiveSampler: the storage must have one dimension, got {index.shape[1]}."
            )
        if len(index):
            self._newest = int(index[-1])

    def update_priority(self, *args: Any, **kwargs: Any) -> None:
        """Do nothing: similarity is the only priority."""

    def state_dict(self) -> dict[str, Any]:
        """K and query, as copies."""
        query = None if self._query is None else self._query.clone()
        return {"k": self.k, "query": query, "newest": self._newest}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Continue where the other sampler was.

        Raises:
            ValueError: If the state is that of another kind of sampler, or a value is malformed.
        """
        check_keys(state_dict, self.state_dict())
        k = check_value("k", state_dict["k"], Finite)
        newest = check_value("newest", state_dict["newest"], NonNegativeInteger | None)
        self.set_query(state_dict["query"])
        self.k, self._newest = k, newest


def _check_no_nan(x: Tensor, what: str) -> None:
    # A sum is NaN if anything is, and costs a fifth of `isnan().any()`.
    if x.is_floating_point() and x.sum().isnan():
        rows = x.isnan().reshape(x.shape[0], -1).any(-1).nonzero().flatten().tolist()
        if rows:
            raise ValueError(
                f"AttentiveSampler: {what} must be finite, got NaN in rows {rows[:8]}."
            )
