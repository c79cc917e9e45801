"""`ReplayConfig`: everything that defines a replay buffer."""

import math
from dataclasses import dataclass, fields
from typing import Literal

from modpush.parts import part_module
from modpush.replay.similarity import SIMILARITIES

__all__ = ["ReplayConfig"]


@dataclass(frozen=True, kw_only=True)
class ReplayConfig:
    """Everything that defines a replay buffer; the defaults are the paper's."""

    capacity: int = 1_000_000
    """Number of transitions that the buffer holds."""
    batch_size: int = 512
    """Number of transitions in each sample."""
    sampler: str = "attentive"
    """How transitions are chosen: "attentive", "uniform", "prioritized", or "module:name" of a
    callable that takes this config and returns a TorchRL sampler."""
    k: float = 4
    """Attentive sampling: number of candidates drawn per transition that is kept."""
    k_end: float | None = None
    """Attentive sampling: value that k is annealed to, linearly; None keeps k as it is."""
    k_annealing_samples: int = 0
    """Attentive sampling: number of samples over which k is annealed."""
    similarity: str = "cosine"
    """Attentive sampling: measure by which candidates are ranked: "cosine", "negative_l2", or
    "module:name" of a callable (candidates [Q, C, D], queries [Q, D]) -> [Q, C]."""
    num_queries: int | None = None
    """Attentive sampling: number of newest transitions whose observations are the present states.
    None takes one per environment in a training run, and the newest one elsewhere."""
    priority_alpha: float = 0.6
    """Prioritized sampling: exponent of the priorities."""
    priority_beta: float = 0.4
    """Prioritized sampling: exponent of the importance weights."""
    storage: Literal["tensor", "memmap", "compact"] = "tensor"
    """Where transitions are held: in memory, on disk, or in memory with each observation once."""
    observation_key: str = "observation"
    """Key of the observation that samplers compare and the compact storage holds once."""
    extra_observation_keys: tuple[str, ...] = ()
    """Further observation keys that the compact storage holds once, such as "window"."""
    n_steps: int = 1
    """Number of steps whose rewards are summed before the target bootstraps. Above 1, fill the
    buffer with `extend_rollout`."""
    gamma: float = 0.98
    """Discount factor per step of the rewards in between; must be the loss's."""
    prefetch: int = 0
    """Number of batches that are prepared ahead in threads."""
    device: str = "cpu"
    """Torch device of the stored transitions."""

    def __post_init__(self) -> None:
        """Check the ranges."""
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, float) and not math.isfinite(value):
                raise ValueError(f"ReplayConfig: {field.name} must be finite, got {value}.")
        for name in ("capacity", "batch_size", "k", "k_end", "num_queries", "n_steps"):
            value = getattr(self, name)
            if value is not None and not value >= 1:
                raise ValueError(f"ReplayConfig: {name} must be >= 1, got {value}.")
        for name in ("priority_alpha", "priority_beta", "prefetch", "k_annealing_samples"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"ReplayConfig: {name} must be >= 0, got {getattr(self, name)}.")
        if not 0 <= self.gamma <= 1:
            raise ValueError(f"ReplayConfig: gamma must be in [0, 1], got {self.gamma}.")
        if self.k_end is not None and self.k_annealing_samples < 1:
            raise ValueError(
                "ReplayConfig: k_annealing_samples must be >= 1 where k_end is given, got "
                f"{self.k_annealing_samples}."
            )
        self._check_choices()
        drawn = self.batch_size * (self.k if self.sampler == "attentive" else 1)
        if drawn > self.capacity:
            raise ValueError(
                f"ReplayConfig: k * batch_size must be <= capacity, got {drawn:g} > "
                f"{self.capacity}."
            )

    def _check_choices(self) -> None:
        for name, choices, own in (
            ("sampler", ("attentive", "uniform", "prioritized"), True),
            ("similarity", tuple(SIMILARITIES), True),
            ("storage", ("tensor", "memmap", "compact"), False),
        ):
            value = getattr(self, name)
            if value in choices or (own and part_module(value)):
                continue
            ending = " or 'module:name'" if own else ""
            raise ValueError(
                f"ReplayConfig: {name} must be one of {choices}{ending}, got {value!r}."
            )
