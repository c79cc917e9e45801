"""States of scenes and of `PushEnv`, and the random numbers of scenes."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from typing import Annotated, Any

import numpy as np
from annotated_types import Len, Lt
from pydantic import Strict

from modpush._state import data_hash
from modpush._types import Finite, NonNegativeInteger, Seed, Several
from modpush._validation import check_value, checked, from_plain
from modpush.envs.engines.base import CONTACT_KEYS
from modpush.envs.outcome import Goal
from modpush.envs.scenes.objects import PushedObject
from modpush.envs.scenes.scenario import Scenario

_Contacts = Annotated[tuple[bool, ...], Strict(False), Len(len(CONTACT_KEYS), len(CONTACT_KEYS))]


@checked
class SceneState:
    """Everything that the future of one scene depends on, in SAPIEN except PhysX's contact cache."""

    scenario: Scenario
    """Start of the episode."""
    physics: Any
    """The numbers that the engine packs, `[n]` float32; on CUDA ManiSkill's state dictionary."""
    target: Annotated[tuple[Finite, Finite, Finite], Strict(False)]
    """The controller's commanded pose (x, y, yaw) [m, m, rad]."""
    contacts: _Contacts
    """Contacts during the last step, in the order of `CONTACT_KEYS`."""
    target_reachable: bool
    """False where the commanded pose had no solution."""
    steps: Annotated[NonNegativeInteger, Lt(2**31)] = 0
    """Number of control steps since the episode's start, by which obstacles that move are placed."""

    def __post_init__(self) -> None:
        """Make arrays of the lists that a file holds."""
        object.__setattr__(self, "physics", _from_plain(self.physics))

    def to_dict(self) -> dict[str, Any]:
        """Plain lists, numbers and strings, ready for JSON, from which every bit comes back."""
        plain = {field.name: getattr(self, field.name) for field in fields(self)}
        scenario, physics = self.scenario.to_dict(), _to_plain(self.physics)
        return {**plain, "scenario": scenario, "physics": physics}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> "SceneState":
        """Inverse of `to_dict`, also after JSON; a ValueError names a field that is wrong."""
        return from_plain(cls, data)


def _to_plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _to_plain(item) for key, item in value.items()}
    return value.tolist()


def _from_plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _from_plain(item) for key, item in value.items()}
    if hasattr(value, "tolist"):
        return value
    try:
        return np.array(value, dtype=np.float32)
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"SceneState: physics must be numbers ({error}).") from error


@checked
class PushState:
    """A state of some scenes of a `PushEnv`, which `PushEnv.set_state` restores.

    It holds plain data only; `to_dict` and `from_dict` convert to JSON and back without loss.
    """

    scenes: Several[SceneState]
    """Physics, layout and controller of each scene."""
    step_count: Several[NonNegativeInteger]
    """Number of steps since the reset of each scene."""
    steps_at_goal: Several[NonNegativeInteger]
    """Number of steps in a row at whose end the object of each scene has been at its goal."""
    rngs: Several[dict[str, Any]]
    """State of the random number generator of each scene."""
    config: dict[str, Any]
    """Properties of the environment that a state belongs to: engine, kind of device, robot, tool, movable
    obstacles, frequencies."""
    objects: dict[str, str]
    """Digest of every object of that environment, by name."""

    def to_dict(self) -> dict[str, Any]:
        """Plain lists, numbers and strings, ready for JSON."""
        plain = {field.name: getattr(self, field.name) for field in fields(self)}
        return {**plain, "scenes": [scene.to_dict() for scene in self.scenes]}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> "PushState":
        """Inverse of `to_dict`, also after JSON; a ValueError names a field that is wrong."""
        count = len(data["step_count"]) if isinstance(data.get("step_count"), list | tuple) else 0
        return from_plain(cls, {"steps_at_goal": [0] * count, **data})  # older ones have none


def make_generators(seed: int | Sequence[int] | None, count: int) -> list[np.random.Generator]:
    """A generator for each of `count` scenes.

    `seed` is one for each scene; or that of the first, alone or in a list, from which scene `i` gets
    `seed + i`; or None for unpredictable numbers.

    Raises:
        ValueError: If there is neither one seed nor one per scene, or one is not a whole number >= 0.
    """
    if seed is None:
        return [np.random.default_rng(s) for s in np.random.SeedSequence().spawn(count)]
    seeds = [seed] if isinstance(seed, int | np.integer) else list(seed)
    seeds = [check_value("seed", one, Seed) for one in seeds]
    if len(seeds) == 1:
        seeds = [seeds[0] + i for i in range(count)]
    if len(seeds) != count:
        raise ValueError(
            f"seed must be one number, or one for each of the {count} scenes, got {len(seeds)}."
        )
    return [np.random.default_rng(s) for s in seeds]


def object_digest(item: PushedObject) -> str:
    """A digest of all that an object is."""
    return data_hash(asdict(item))


def check_state(
    state: PushState, count: int, config: Mapping[str, Any], objects: Mapping[str, str], goal: Goal
) -> None:
    """Check that a state can be restored in `count` scenes of an environment, before anything changes.

    `config` are the environment's options that a state belongs to, and `objects` digests of its objects
    by name. A TypeError or a ValueError says what does not fit.
    """
    if not isinstance(state, PushState):
        raise TypeError(f"state must be a PushState, got {type(state).__name__}.")
    for name in ("scenes", "step_count", "steps_at_goal", "rngs"):
        if (found := len(getattr(state, name))) != count:
            raise ValueError(f"the state holds {found} {name}, expected {count}.")
    given = {"robot": "ur5", **state.config}  # older states know no other
    if given != dict(config):
        differences = [
            f"{name}={given.get(name)!r} (expected {config.get(name)!r})"
            for name in sorted({*given, *config})
            if given.get(name) != config.get(name)
        ]
        raise ValueError(f"the state is of an environment with {', '.join(differences)}.")
    for scene in state.scenes:
        name, goal_yaw = scene.scenario.pushed_object, scene.scenario.goal_yaw
        if (goal == "pose") != (goal_yaw is not None):
            raise ValueError(
                f"the state's goal_yaw is {goal_yaw}, which is not of an environment with goal={goal!r}."
            )
        if name not in objects:
            raise ValueError(
                f"the state's object {name!r} is not in this environment, which has "
                f"{sorted(objects)}."
            )
        if state.objects.get(name) != objects[name]:
            raise ValueError(
                f"the state's object {name!r} must be this environment's of that name, got "
                f"{state.objects.get(name)!r} for {objects[name]!r}."
            )
    for rng in state.rngs:
        try:
            np.random.default_rng(0).bit_generator.state = rng
        except (TypeError, ValueError, KeyError, OverflowError) as error:
            raise ValueError(
                f"the state of a random number generator is damaged ({error})."
            ) from error
