"""A replay buffer in one call."""

from dataclasses import dataclass
from typing import Any, Literal

import torch
from torchrl.data import (
    LazyMemmapStorage,
    LazyTensorStorage,
    PrioritizedSampler,
    RandomSampler,
    RoundRobinWriter,
    TensorDictReplayBuffer,
)
from torchrl.data.replay_buffers.samplers import Sampler
from torchrl.data.replay_buffers.storages import Storage
from torchrl.envs.transforms import MultiStepTransform

from modpush.replay.attentive import AttentiveSampler
from modpush.replay.compact import CompactStorage
from modpush.replay.similarity import SIMILARITIES

__all__ = ["ReplayConfig", "make_replay_buffer"]


@dataclass(frozen=True, kw_only=True)
class ReplayConfig:
    """Everything that defines a replay buffer; the defaults are the paper's."""

    capacity: int = 1_000_000
    """Transitions held."""
    batch_size: int = 512
    """Transitions a sample."""
    sampler: Literal["attentive", "uniform", "prioritized"] = "attentive"
    """How transitions are chosen."""
    k: float = 4
    """Attentive: candidates per kept transition."""
    k_end: float | None = None
    """Attentive: where k is annealed to; None keeps it."""
    k_annealing_samples: int = 0
    """Attentive: samples over which k is annealed."""
    similarity: Literal["cosine", "negative_l2"] = "cosine"
    """Attentive: what similar means."""
    num_queries: int = 1
    """Attentive: newest transitions taken as the present states, one per environment."""
    priority_alpha: float = 0.6
    """Prioritized: exponent of the priorities."""
    priority_beta: float = 0.4
    """Prioritized: exponent of the importance weights."""
    storage: Literal["tensor", "memmap", "compact"] = "tensor"
    """In memory, on disk, or in memory with each observation stored once."""
    observation_key: str = "observation"
    """The observation that is compared and stored once."""
    n_steps: int = 1
    """Steps a target looks ahead, through TorchRL's `MultiStepTransform`; extend the buffer with
    whole stretches `[num_envs, time]` of trajectories then."""
    gamma: float = 0.98
    """Discount of the steps in between [per step]."""
    prefetch: int = 0
    """Batches prepared ahead in threads."""
    device: str = "cpu"
    """Where the transitions are kept."""

    def __post_init__(self) -> None:
        """Check the ranges."""
        for name in ("capacity", "batch_size", "k", "num_queries", "n_steps"):
            if not getattr(self, name) >= 1:
                raise ValueError(f"ReplayConfig: {name} must be >= 1, got {getattr(self, name)}.")
        for name in ("priority_alpha", "priority_beta", "prefetch", "k_annealing_samples"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"ReplayConfig: {name} must be >= 0, got {getattr(self, name)}.")
        for name, choices in (
            ("sampler", ("attentive", "uniform", "prioritized")),
            ("storage", ("tensor", "memmap", "compact")),
            ("similarity", tuple(SIMILARITIES)),
        ):
            if getattr(self, name) not in choices:
                raise ValueError(
                    f"ReplayConfig: {name} must be one of {choices}, got {getattr(self, name)!r}."
                )
        drawn = self.batch_size * (self.k if self.sampler == "attentive" else 1)
        if drawn > self.capacity:
            raise ValueError(
                f"ReplayConfig: k * batch_size must be <= capacity, got {drawn:g} > "
                f"{self.capacity}."
            )


def make_replay_buffer(config: ReplayConfig, **kwargs: Any) -> TensorDictReplayBuffer:
    """Build a replay buffer of transitions.

    Args:
        config: The buffer's settings.
        **kwargs: Further arguments of TorchRL's `TensorDictReplayBuffer`, such as `transform`.

    Returns:
        The buffer, empty. Its priority key is the loss's, `"td_error"`.

    Raises:
        RuntimeError: For `sampler="prioritized"` where TorchRL's C++ extension does not load.
    """
    if config.storage == "compact":
        kwargs.setdefault("writer", RoundRobinWriter())  # TorchRL's default stores the index, too
    buffer = TensorDictReplayBuffer(
        storage=_make_storage(config),
        sampler=_make_sampler(config),
        batch_size=config.batch_size,
        prefetch=config.prefetch or None,
        priority_key="td_error",
        **kwargs,
    )
    if config.n_steps > 1:
        buffer.append_transform(MultiStepTransform(config.n_steps, config.gamma))
    return buffer


def _make_storage(config: ReplayConfig) -> Storage:
    device = torch.device(config.device)
    if config.storage == "compact":
        return CompactStorage(config.capacity, keys=[config.observation_key], device=device)
    storage = LazyTensorStorage if config.storage == "tensor" else LazyMemmapStorage
    return storage(config.capacity, device=device)


def _make_sampler(config: ReplayConfig) -> Sampler:
    if config.sampler == "uniform":
        return RandomSampler()
    if config.sampler == "attentive":
        return AttentiveSampler(
            config.k,
            key=config.observation_key,
            similarity=config.similarity,
            num_queries=config.num_queries,
            k_end=config.k_end,
            annealing_num_samples=config.k_annealing_samples,
        )
    try:
        return PrioritizedSampler(
            config.capacity, alpha=config.priority_alpha, beta=config.priority_beta
        )
    except RuntimeError as error:
        raise RuntimeError(
            "make_replay_buffer: sampler='prioritized' needs TorchRL's C++ extension, which does "
            f"not load with torch {torch.__version__} ({error}). Install a torchrl built for this "
            "torch, or use sampler='attentive' or 'uniform'."
        ) from error
