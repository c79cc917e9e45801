"""`RecordedEngine`: a recorded episode in place of physics, for instance to be seen with another goal."""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modpush.envs.engines.base import CONTACT_KEYS, NAME_OF_PAIR, Engine, SceneSpec
from modpush.envs.scenes.objects import get_object_of
from modpush.envs.scenes.scenario import Scenario


@dataclass(frozen=True, kw_only=True)
class Recording:
    """Course of an episode of T control steps, in the robot's base frame [m, rad]."""

    object_pose: NDArray[np.float32]
    """Pose of the object at reset and after each step, `[T + 1, 3]`."""
    ee_pose: NDArray[np.float32]
    """Pose of the tool's tip at reset and after each step, `[T + 1, 3]`."""
    joint_position: NDArray[np.float32]
    """Angles of the arm's joints at reset and after each step, `[T + 1, n]`."""
    contacts: NDArray[np.bool_]
    """Contacts of each step, in the order of `CONTACT_KEYS`, `[T, 6]`."""

    def __len__(self) -> int:
        return len(self.contacts)


class RecordedEngine(Engine):
    """Moves object and arm as they moved in a recording, whatever the targets of the drives.

    Assign `recording` before each reset of the scene; after its last step the scene stays as it is. The
    object stands upright, obstacles are where the layout has them at that time, and of the arm only
    joints and tip are known, so that a camera cannot see it.
    """

    name, version, default_sim_freq = "recorded", "1", 120

    def __init__(self, spec: SceneSpec) -> None:
        self._objects, self._control_freq = spec.objects, spec.control_freq
        self._step = 0
        self.recording: Recording | None = None
        """The episode that is played from the next reset on."""

    def load(self, scenario: Scenario, joints: NDArray[np.float32]) -> None:
        if self.recording is None:
            raise ValueError("RecordedEngine: assign a recording before the reset, got None.")
        self._scenario, self._step = scenario, 0
        self._played = self.recording
        self._height = get_object_of(self._objects, scenario.pushed_object).height

    def advance(
        self,
        position: Sequence[Sequence[float]],
        velocity: Sequence[Sequence[float]],
        looks: Collection[int],
        obstacles: NDArray[np.float64] | None = None,
    ) -> list[bool]:
        if self._step == len(self._played):
            return [False] * len(CONTACT_KEYS)
        self._step += 1
        return self._played.contacts[self._step - 1].tolist()

    def joint_position(self) -> NDArray[np.float32]:
        return self._played.joint_position[self._step]

    def object_transform(self) -> Sequence[float]:
        return _upright(self._played.object_pose[self._step].tolist(), self._height / 2)

    def obstacle_transforms(self) -> NDArray[np.float64]:
        time = self._step / self._control_freq
        rows = [
            _upright((*o.at(time)[:2].tolist(), o.pose[2]), o.size[2] / 2)
            for o in self._scenario.obstacles
        ]
        return np.array(rows).reshape(-1, 7)

    def link_transforms(self, names: Sequence[str]) -> Sequence[Sequence[float]]:
        """See `Engine`; of the tip alone.

        Raises:
            ValueError: For other links.
        """
        if other := sorted(set(names) - {"tip"}):
            raise ValueError(
                f"RecordedEngine: names must be ['tip'], the recorded link, got {other}."
            )
        return [_upright(self._played.ee_pose[self._step].tolist(), 0.0)] * len(names)

    def gaps(self) -> dict[str, float]:
        """No distance is recorded: all are infinite."""
        return dict.fromkeys(NAME_OF_PAIR.values(), math.inf)

    def pack(self) -> NDArray[np.float32]:
        """The place in the recording."""
        return np.array([self._step], dtype=np.float32)

    def unpack(self, packed: NDArray[np.float32]) -> None:
        self._step = int(packed[0])

    def check_packed(self, packed: NDArray[np.float32], scenario: Scenario) -> None:
        last = 0 if self.recording is None else len(self.recording)
        if packed.shape != (1,) or not 0 <= packed[0] <= last:
            raise ValueError(f"RecordedEngine: expected a step in [0, {last}], got {packed}.")

    def close(self) -> None:
        """Nothing is held."""


def _upright(pose: Sequence[float], height: float) -> list[float]:
    x, y, yaw = pose
    return [x, y, height, math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)]
