"""What a worker tells the learner: the environment's specs, and what its scenes did."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tensordict import NestedKey
from torchrl.data import Bounded, Composite

__all__ = ["Rollout", "WorkerSpecs"]


@dataclass(frozen=True)
class WorkerSpecs:
    """What a learner has to know of the environment that a worker steps."""

    observation: Composite
    """The environment's `full_observation_spec_unbatched`."""
    action: Bounded
    """Spec of one action, `[A]`."""
    latent: slice
    """The encoder's columns of the observation; empty without an encoder."""
    fingerprint: dict[str, Any]
    """What a policy depends on, see `modpush.recipes.environment_fingerprint`."""


@dataclass(frozen=True)
class Rollout:
    """What `B` scenes did in `T` steps between two exchanges with the learner."""

    transitions: dict[NestedKey, NDArray]
    """Arrays `[T * B, ...]` by key, scene after scene within a step. They are arrays because torch
    would send each tensor to another process through shared memory, with a file handle each."""
    last_observation: NDArray[np.float32]
    """Observations that the scenes are in now, `[B, n]`."""
    episodes: list[dict[str, float]]
    """Metrics of the episodes that ended: success, steps, return, contact, collision, greedy."""
    level: int
    """The curriculum's level."""
    success_by_family: dict[str, float]
    """Success of recent episodes, by scene family."""
