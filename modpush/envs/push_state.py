"""`PushState`: what `PushEnv.get_state` returns."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np

from modpush._checks import check_keys
from modpush._state import data_hash
from modpush.envs.outcome import Goal
from modpush.envs.scene_state import SceneState
from modpush.envs.scenes.objects import PushedObject


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
