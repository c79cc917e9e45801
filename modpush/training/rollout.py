"""Messages of a worker to the learner: the environment's specs, and rollouts."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tensordict import NestedKey
from torchrl.data import Bounded, Composite


@dataclass(frozen=True)
class WorkerSpecs:
    """Specs and fingerprint of the environment that a worker steps."""

    observation: Composite
    """The environment's `full_observation_spec_unbatched`."""
    action: Bounded
    """Spec of one action, `[A]`."""
    columns: dict[str, slice]
    """The columns of each entry of the observation, by name; empty without a `PushObservation`."""
    fingerprint: dict[str, Any]
    """Fingerprint, see `modpush.recipes.environment_fingerprint`."""


@dataclass(frozen=True)
class Outcome:
    """Result of an episode, for the curriculum."""

    level: int
    """The curriculum's level that the episode is of."""
    success: bool
    """True if the object reached the goal."""
    scene: str
    """Name of the scene."""
    evaluated: bool
    """True if the episode counts towards the next stage."""


@dataclass(frozen=True)
class Rollout:
    """`T` steps of `B` scenes between two exchanges with the learner."""

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
    hindsight: dict[NestedKey, NDArray] = field(default_factory=dict)
    """Further transitions `[N, ...]`, of episodes with another goal, see `Hindsight`."""
    source: int = 0
    """Number of the collector."""
    begins: bool = False
    """True if the scenes were reset before it, without the end of an episode in the data."""
    version: int = 0
    """Number of the weights that it was collected with, counted from 1 as they were sent."""
    behind: int = 0
    """Number of later weights that were sent to other collectors until then."""
    outcomes: list[Outcome] = field(default_factory=list)
    """Results for the collector's own curriculum; empty where it is the only one."""
