"""`ReplayConfig`: everything that defines a replay buffer."""

from typing import Annotated, Literal

from annotated_types import Ge

from modpush._types import (
    Count,
    Device,
    Finite,
    Fraction,
    Name,
    NonNegative,
    NonNegativeInteger,
)
from modpush._validation import checked
from modpush.parts import check_part
from modpush.replay.attentive import SIMILARITIES

SAMPLER_NAMES = ("attentive", "uniform", "prioritized")
"""Names of the samplers of `make_replay_buffer`."""

Candidates = Annotated[Finite, Ge(1)]
"""A number of candidates for each transition that is sampled, >= 1."""


@checked
class ReplayConfig:
    """Everything that defines a replay buffer; the defaults are the paper's."""

    capacity: Count = 1_000_000
    """Number of transitions that the buffer holds."""
    batch_size: Count = 512
    """Number of transitions in each sample."""
    sampler: str = "attentive"
    """Sampler of the transitions: "attentive", "uniform", "prioritized", or "module:name" of a callable
    that takes this config and returns a TorchRL sampler."""
    k: Candidates = 4
    """Attentive sampling: number of candidates drawn per transition that is kept."""
    similarity: str = "cosine"
    """Attentive sampling: measure by which candidates are ranked: "cosine", "negative_l2", or
    "module:name" of a callable (candidates [Q, C, D], queries [Q, D]) -> [Q, C]."""
    num_queries: Count | None = None
    """Attentive sampling: number of newest transitions whose observations are the present states.
    None takes one per environment in a training run, and the newest one elsewhere."""
    priority_alpha: NonNegative = 0.6
    """Prioritized sampling: exponent of the priorities."""
    priority_beta: NonNegative = 0.4
    """Prioritized sampling: exponent of the importance weights."""
    storage: Literal["tensor", "memmap"] = "tensor"
    """Storage of the transitions: in memory or on disk."""
    observation_key: Name = "observation"
    """Key of the observation that samplers compare."""
    n_steps: Count = 1
    """Number of steps whose rewards are summed before the target bootstraps. Above 1, fill the
    buffer with `extend_rollout`."""
    gamma: Fraction = 0.98
    """Discount factor per step of the summed rewards; must equal the loss's."""
    prefetch: NonNegativeInteger = 0
    """Number of batches that are prepared ahead in threads."""
    device: Device = "cpu"
    """Torch device of the stored transitions."""

    def __post_init__(self) -> None:
        """Check names, and what depends on several fields."""
        check_part("ReplayConfig: sampler", self.sampler, SAMPLER_NAMES)
        check_part("ReplayConfig: similarity", self.similarity, SIMILARITIES)
        drawn = self.batch_size * (self.k if self.sampler == "attentive" else 1)
        if drawn > self.capacity:
            raise ValueError(
                f"ReplayConfig: k * batch_size must be <= capacity, got {drawn:g} > "
                f"{self.capacity}."
            )
