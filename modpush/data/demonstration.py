"""`Demonstration`: one recorded episode, and its file."""

import json
from collections.abc import Collection
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modpush.envs.robot.ur5_2f85 import JOINT_NAMES
from modpush.envs.scene_state import SceneState
from modpush.envs.scenes.scenario import Scenario
from modpush.files import read_arrays, reading, write_arrays
from modpush.parts import check_allowed

__all__ = ["FLAG_KEYS", "POSE_KEYS", "Demonstration", "body_state"]

_KIND, _VERSION = "modpush.Demonstration", 1

POSE_KEYS = ("object_pose", "goal_position", "ee_pose")
"""Numbers of `PushEnv` that are recorded at reset and after each step."""
FLAG_KEYS = (
    "success",
    "out_of_bounds",
    "object_contact",
    "obstacle_contact",
    "tool_obstacle_contact",
)
"""Flags of `PushEnv` that are recorded at reset and after each step."""


def body_state(scene: SceneState) -> NDArray[np.float32]:
    """Poses and velocities of the bodies, angles and rates of the joints, as PhysX packs them, `[k]`.

    The drives' targets are left out: every step sets them, and what they are before the first one is
    of an earlier episode.
    """
    return np.array(scene.physics[: -2 * len(JOINT_NAMES)])


@dataclass(frozen=True, kw_only=True, eq=False)
class Demonstration:
    """An episode of T control steps. Base frame, metres and radians, unless said otherwise."""

    policy: str
    """Name of the policy that acted."""
    number: int
    """Number of its start among those of the data set."""
    seed: int
    """Seed that the start was drawn from: `env.reset(seed=...)` starts there."""
    scenario: Scenario
    """The start."""
    observation: NDArray[np.float32]
    """Observation at reset and after each step, `[T + 1, n]`."""
    action: NDArray[np.float32]
    """Action in the axes of the recorded environment, `[T, 3]` in [-1, 1]."""
    command: NDArray[np.float32]
    """The same action as `PushEnv` took it, in the base frame, `[T, 3]` in [-1, 1]."""
    reward: NDArray[np.float32]
    """Reward of each step, `[T]`."""
    terminated: NDArray[np.bool_]
    """Whether each step reached a terminal state, `[T]`."""
    truncated: NDArray[np.bool_]
    """Whether each step cut the episode off, `[T]`."""
    poses: dict[str, NDArray[np.float32]]
    """`POSE_KEYS` at reset and after each step, `[T + 1, k]`."""
    flags: dict[str, NDArray[np.bool_]]
    """`FLAG_KEYS` at reset and after each step, `[T + 1]`."""
    physics: NDArray[np.float32]
    """`body_state` at reset and after each step, `[T + 1, k]`."""
    target: NDArray[np.float64]
    """Commanded pose of the tool at reset and after each step, `[T + 1, 3]`."""
    depth: NDArray[np.float32] | None = None
    """Depth images at reset and after each step, `[T + 1, 256, 256]` [m]."""
    segmentation: NDArray[np.uint8] | None = None
    """What each pixel shows, `[T + 1, 256, 256]`."""

    def __len__(self) -> int:
        return len(self.action)

    @property
    def success(self) -> bool:
        """Whether the episode reached the goal."""
        return bool(self.flags["success"][-1])

    def save(self, path: Path) -> None:
        """Write as a compressed `.npz` with a checksum, atomically."""
        arrays: dict[str, NDArray[Any]] = {}
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, dict):
                arrays |= {f"{field.name}/{key}": item for key, item in value.items()}
            elif isinstance(value, np.ndarray):
                arrays[field.name] = value
        about = {
            "policy": self.policy,
            "number": self.number,
            "seed": self.seed,
            "scenario": self.scenario.to_dict(),
        }
        write_arrays(path, {"about": np.array(json.dumps(about)), **arrays}, _KIND, _VERSION)

    @classmethod
    def load(cls, path: Path | str, *, allow: Collection[str] = ()) -> "Demonstration":
        """Read what `save` wrote.

        Args:
            path: The file.
            allow: Modules and packages from which it may name its object and its scene.

        Raises:
            FileNotFoundError: If there is no such file.
            ValueError: If it is damaged, no demonstration, or names modules that are not allowed.
        """
        with reading(path, _KIND):
            arrays = read_arrays(path, _KIND, _VERSION)
            content: dict[str, Any] = json.loads(str(arrays.pop("about")))
            check_allowed(f"{_KIND}: {path}", content["scenario"], allow)
            content["scenario"] = Scenario.from_dict(content["scenario"])
            for name, value in arrays.items():
                group, _, key = name.partition("/")
                if key:
                    content.setdefault(group, {})[key] = value
                else:
                    content[name] = value
            return cls(**content)
