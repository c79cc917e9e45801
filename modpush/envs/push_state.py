"""`PushState`: what `PushEnv.get_state` returns."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from modpush.envs.sim.batch import SceneState

__all__ = ["PushState"]


@dataclass(frozen=True)
class PushState:
    """A state of some scenes of a `PushEnv`, which `PushEnv.set_state` restores."""

    scenes: tuple[SceneState, ...]
    """Physics, layout and controller of each scene."""
    step_count: tuple[int, ...]
    """Number of steps since the reset of each scene."""
    rngs: tuple[Mapping[str, Any], ...]
    """State of the random number generator of each scene."""
