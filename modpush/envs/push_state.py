"""States of scenes and of `PushEnv`, and the random numbers of scenes."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np

from modpush._checks import check_keys
from modpush._state import data_hash
from modpush._types import Seed
from modpush._validation import check_value
from modpush.envs.engines.base import CONTACT_KEYS
from modpush.envs.outcome import Goal
from modpush.envs.scenes.objects import PushedObject
from modpush.envs.scenes.scenario import Scenario


@dataclass(frozen=True, kw_only=True, eq=False)
class SceneState:
    """Everything that the future of one scene depends on, in SAPIEN except PhysX's contact cache.

    Raises:
        ValueError: If `target` is not three finite numbers, or `contacts` not six truth values.
    """

    scenario: Scenario
    """Start of the episode."""
    physics: Any
    """The numbers that the engine packs, `[n]` float32; on CUDA ManiSkill's state dictionary."""
    target: tuple[float, float, float]
    """The controller's commanded pose (x, y, yaw) [m, m, rad]."""
    contacts: tuple[bool, ...]
    """Contacts during the last step, in the order of `CONTACT_KEYS`."""
    target_reachable: bool
    """False where the commanded pose had no solution."""
    steps: int = 0
    """Number of control steps since the episode's start, by which obstacles that move are placed."""

    def __post_init__(self) -> None:
        """Check what is not checked against an environment."""
        if len(self.target) != 3 or not all(math.isfinite(x) for x in self.target):
            raise ValueError(f"SceneState: target must be 3 finite numbers, got {self.target}.")
        count = len(CONTACT_KEYS)
        if len(self.contacts) != count or not all(isinstance(x, bool) for x in self.contacts):
            raise ValueError(f"SceneState: contacts must be {count} booleans, got {self.contacts}.")
        if not isinstance(self.target_reachable, bool):
            raise ValueError(
                f"SceneState: target_reachable must be a boolean, got {self.target_reachable!r}."
            )
        if type(self.steps) is not int or not 0 <= self.steps < 2**31:
            raise ValueError(f"SceneState: steps must be an integer >= 0, got {self.steps!r}.")

    def to_dict(self) -> dict[str, Any]:
        """Plain lists, numbers and strings, ready for JSON, from which every bit comes back."""
        return {
            "scenario": self.scenario.to_dict(),
            "physics": _to_plain(self.physics),
            "target": list(self.target),
            "contacts": list(self.contacts),
            "target_reachable": self.target_reachable,
            "steps": self.steps,
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> "SceneState":
        """Inverse of `to_dict`, also after a round trip through JSON.

        Raises:
            ValueError: If a field is missing, unknown or malformed.
        """
        data = {"steps": 0, **data}  # an older one has none
        check_keys(data, [field.name for field in fields(cls)])
        try:
            return cls(
                scenario=Scenario.from_dict(data["scenario"]),
                physics=_from_plain(data["physics"]),
                target=tuple(float(x) for x in data["target"]),  # type: ignore[arg-type]  # checked
                contacts=tuple(data["contacts"]),
                target_reachable=data["target_reachable"],
                steps=data["steps"],
            )
        except TypeError as error:
            raise ValueError(f"SceneState: a value is malformed ({error}).") from error


def _to_plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _to_plain(item) for key, item in value.items()}
    return value.tolist()


def _from_plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _from_plain(item) for key, item in value.items()}
    try:
        return np.array(value, dtype=np.float32)
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"SceneState: physics must be numbers ({error}).") from error


def make_generators(seed: int | Sequence[int] | None, count: int) -> list[np.random.Generator]:
    """A generator for each scene.

    Args:
        seed: One for each scene; or that of the first, alone or in a list, from which scene `i` gets
            `seed + i`; or None for unpredictable numbers.
        count: Number of scenes.

    Raises:
        ValueError: If there is neither one seed nor one per scene, or one is not a whole number >= 0.
    """
    if seed is None:
        return [np.random.default_rng(s) for s in np.random.SeedSequence().spawn(count)]
    seeds = [seed] if isinstance(seed, int | np.integer) else list(seed)
    for one in seeds:
        check_value("seed", one.item() if isinstance(one, np.generic) else one, Seed)
    if len(seeds) == 1:
        seeds = [seeds[0] + i for i in range(count)]
    if len(seeds) != count:
        raise ValueError(
            f"seed must be one number, or one for each of the {count} scenes, got {len(seeds)}."
        )
    return [np.random.default_rng(s) for s in seeds]


def restart_generators(
    generators: list[np.random.Generator], indices: Sequence[int], seed: int | None
) -> None:
    """Seed the generators of some scenes again, that of scene i with `seed + i`; None leaves them.

    Raises:
        ValueError: If the seed is not a whole number >= 0.
    """
    if check_value("seed", seed, Seed | None) is not None:
        for i in indices:
            generators[i] = np.random.default_rng(int(seed) + i)  # type: ignore[arg-type]  # checked


@dataclass(frozen=True, kw_only=True, eq=False)
class PushState:
    """A state of some scenes of a `PushEnv`, which `PushEnv.set_state` restores.

    It holds plain data only; `to_dict` and `from_dict` convert to JSON and back without loss.
    """

    scenes: tuple[SceneState, ...]
    """Physics, layout and controller of each scene."""
    step_count: tuple[int, ...]
    """Number of steps since the reset of each scene."""
    steps_at_goal: tuple[int, ...]
    """Number of steps in a row at whose end the object of each scene has been at its goal."""
    rngs: tuple[Mapping[str, Any], ...]
    """State of the random number generator of each scene."""
    config: Mapping[str, Any]
    """Properties of the environment that a state belongs to: engine, kind of device, robot, tool, movable
    obstacles, frequencies."""
    objects: Mapping[str, str]
    """Digest of every object of that environment, by name."""

    def to_dict(self) -> dict[str, Any]:
        """Plain lists, numbers and strings, ready for JSON."""
        return {
            "scenes": [scene.to_dict() for scene in self.scenes],
            "step_count": list(self.step_count),
            "steps_at_goal": list(self.steps_at_goal),
            "rngs": [dict(rng) for rng in self.rngs],
            "config": dict(self.config),
            "objects": dict(self.objects),
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> "PushState":
        """Inverse of `to_dict`, also after a round trip through JSON.

        Raises:
            ValueError: If a field is missing, unknown or malformed.
        """
        if "steps_at_goal" not in data and isinstance(data.get("step_count"), list):  # an older one
            data = {**data, "steps_at_goal": [0] * len(data["step_count"])}
        check_keys(data, [field.name for field in fields(cls)])
        lists = dict.fromkeys(("scenes", "step_count", "steps_at_goal", "rngs"), list)
        kinds = {**lists, "config": dict, "objects": dict}
        for name, kind in kinds.items():
            if not isinstance(data[name], kind):
                raise ValueError(
                    f"PushState: {name} must be a {kind.__name__}, got {data[name]!r}."
                )
        return cls(
            scenes=tuple(SceneState.from_dict(scene) for scene in data["scenes"]),
            step_count=tuple(data["step_count"]),
            steps_at_goal=tuple(data["steps_at_goal"]),
            rngs=tuple(data["rngs"]),
            config=data["config"],
            objects=data["objects"],
        )


def object_digest(item: PushedObject) -> str:
    """A digest of all that an object is."""
    return data_hash(asdict(item))


def check_state(
    state: PushState,
    count: int,
    config: Mapping[str, Any],
    objects: Mapping[str, str],
    goal: Goal,
) -> None:
    """Check that a state can be restored in an environment.

    Args:
        state: The state.
        count: Number of scenes that are to be put into it.
        config: The environment's options that a state belongs to.
        objects: Digests of the environment's objects, by name.
        goal: Kind of the goals of the environment's episodes.

    Raises:
        TypeError: If it is not a `PushState`.
        ValueError: If it is of another environment or number of scenes, or damaged.
    """
    if not isinstance(state, PushState):
        raise TypeError(f"state must be a PushState, got {type(state).__name__}.")
    if len(state.scenes) != count:
        raise ValueError(f"the state holds {len(state.scenes)} scenes, expected {count}.")
    given = {"robot": "ur5", **state.config}  # older states know no other
    if given != dict(config):
        names = sorted(set(given) | set(config))
        differences = [
            f"{name}={given.get(name)!r} (expected {config.get(name)!r})"
            for name in names
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
    for name in ("step_count", "steps_at_goal"):
        _check_counts(name, getattr(state, name), count)
    _check_rngs(state.rngs, count)


def _check_counts(name: str, steps: Sequence[Any], count: int) -> None:
    if len(steps) != count or not all(type(n) is int and n >= 0 for n in steps):
        raise ValueError(f"{name} must be {count} integers >= 0, got {steps!r}.")


def _check_rngs(rngs: Sequence[Mapping[str, Any]], count: int) -> None:
    if len(rngs) != count:
        raise ValueError(f"the state holds {len(rngs)} random states, expected {count}.")
    for rng in rngs:
        try:
            np.random.default_rng(0).bit_generator.state = rng
        except (TypeError, ValueError, KeyError, OverflowError) as error:
            raise ValueError(
                f"the state of a random number generator is damaged ({error})."
            ) from error
