"""`SceneState`, everything that the future of one scene depends on, and the generators of a batch."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from modpush._checks import check_keys
from modpush._types import Seed
from modpush._validation import check_value
from modpush.envs.engines.base import CONTACT_KEYS
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
