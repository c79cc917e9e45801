"""What a worker tells the learner: the environment's specs, and what its scenes did."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tensordict import NestedKey
from torchrl.data import Bounded, Composite

__all__ = ["Outcome", "Rollout", "WorkerSpecs"]


@dataclass(frozen=True)
class WorkerSpecs:
    """What a learner has to know of the environment that a worker steps."""

    observation: Composite
    """The environment's `full_observation_spec_unbatched`."""
    action: Bounded
    """Spec of one action, `[A]`."""
    columns: dict[str, slice]
    """The columns of each entry of the observation, by name; empty without a `PushObservation`."""
    fingerprint: dict[str, Any]
    """What a policy depends on, see `modpush.recipes.environment_fingerprint`."""


@dataclass(frozen=True)
class Outcome:
    """An episode that the curriculum is told of."""

    level: int
    """The curriculum's level that the episode is of."""
    success: bool
    """Whether the object reached the goal."""
    scene: str
    """Name of the scene."""
    evaluated: bool
    """Whether the episode counts towards the next stage."""


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
    source: int = 0
    """Which of several collectors it is of."""
    begins: bool = False
    """Whether the scenes began anew before it, without the end of an episode in the data."""
    version: int = 0
    """Which of the weights that were sent it was collected with, counted from 1."""
    behind: int = 0
    """How many later weights were sent to other collectors meanwhile."""
    outcomes: list[Outcome] = field(default_factory=list)
    """Episodes that the collector's curriculum was told of; empty where it is the only one."""
