"""`MujocoEngine`: one scene in MuJoCo."""

import math
from collections.abc import Collection, Sequence
from typing import ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from modpush.envs.engines.base import (
    CONTACT_KEYS,
    ENGINES,
    NAME_OF_PAIR,
    PAIRS,
    Engine,
    SceneSpec,
    check_quaternions,
    check_vector,
)
from modpush.envs.engines.mujoco.model import build_model
from modpush.envs.engines.mujoco.rendering import draw_picture
from modpush.envs.scenes.objects import get_object_of
from modpush.envs.scenes.scenario import Scenario

_AT_END = len(CONTACT_KEYS) // 2  # index of the first that is about the step's end
_LEAST_FREQ = 240
_LARGEST = 1e4  # of positions and velocities that a simulation can have had [m, m/s, rad/s]
_STATE = (
    mujoco.mjtState.mjSTATE_QPOS | mujoco.mjtState.mjSTATE_QVEL | mujoco.mjtState.mjSTATE_WARMSTART
)


class MujocoEngine(Engine):
    """Places, steps and reads the bodies of one scene.

    Every episode has a model of its own, so that it depends on nothing that was before. A step is split
    such that positions and contacts are those after it: MuJoCo's own `mj_step` leaves those before it.

    Raises:
        ValueError: If the rate is too low for stable drives.
    """

    name: ClassVar = "mujoco"
    version: ClassVar = mujoco.__version__
    default_sim_freq: ClassVar = ENGINES["mujoco"].sim_freq

    def __init__(self, spec: SceneSpec) -> None:
        if spec.sim_freq < _LEAST_FREQ:
            raise ValueError(
                f"PushEnv: sim_freq must be at least {_LEAST_FREQ} in MuJoCo, whose contacts and drives "
                f"need it (None takes {self.default_sim_freq}), got {spec.sim_freq}."
            )
        self._spec, self._num_joints = spec, len(spec.robot.joints)
        self._lag = spec.robot.damping / spec.robot.stiffness

    def load(self, scenario: Scenario, joints: NDArray[np.float32]) -> None:
        item = get_object_of(self._spec.objects, scenario.pushed_object)
        self._goal = scenario.goal_position
        model = self._model = build_model(self._spec, scenario, item)
        data = self._data = mujoco.MjData(model)
        self._category = model.geom_contype.copy()
        names = [*(link.name for link in self._spec.robot.links), "tool", "tip", "object"]
        self._bodies = {name: int(model.body(name).id) for name in names}
        first = self._bodies["object"] + 1
        self._obstacles = slice(first, first + len(scenario.obstacles))
        self._ctrl = data.ctrl
        data.qpos[: self._num_joints] = joints
        moving = {i: o for i, o in enumerate(scenario.obstacles) if o.motion is not None}
        if moving:
            joints_of = [int(model.body_jntadr[first + i]) for i in moving]
            self._moving = (
                model.jnt_qposadr[joints_of][:, None] + np.arange(7),
                model.jnt_dofadr[joints_of][:, None] + np.arange(6),
            )
            self._upright = data.qpos[self._moving[0]]
            self._move_obstacles(np.array([o.at(0.0) for o in moving.values()]))
        mujoco.mj_step1(model, data)

    def advance(
        self,
        position: Sequence[Sequence[float]],
        velocity: Sequence[Sequence[float]],
        looks: Collection[int],
        obstacles: NDArray[np.float64] | None = None,
    ) -> list[bool]:
        model, data, ctrl = self._model, self._data, self._ctrl
        targets = np.array(position) + np.array(velocity) * self._lag
        touched = [False] * _AT_END
        now = touched
        for substep, row in enumerate(targets, start=1):
            ctrl[:] = row
            mujoco.mj_step2(model, data)
            if obstacles is not None:
                self._move_obstacles(obstacles[substep - 1])
            mujoco.mj_step1(model, data)
            if substep in looks:
                now = self._touching()
                touched = [a or b for a, b in zip(touched, now, strict=True)]
        return [*touched, *now]

    def _move_obstacles(self, targets: NDArray[np.float64]) -> None:
        """Put the obstacles that move by themselves where they are to be, `[m, 4]` as in `advance`."""
        places, rates = self._moving
        self._upright[:, :2] = targets[:, :2]
        self._data.qpos[places] = self._upright
        self._data.qvel[rates] = 0.0
        self._data.qvel[rates[:, :2]] = targets[:, 2:]

    def _pairs(self) -> NDArray[np.int32]:
        """Categories of both bodies of each present contact, `[n]`; all are nearer than `CONTACT_GAP`."""
        first, second = self._data.contact.geom.reshape(-1, 2).T
        return self._category[first] | self._category[second]

    def _touching(self) -> list[bool]:
        found = set(self._pairs().tolist())
        return [pair in found for pair in PAIRS]

    @property
    def simulation(self) -> "tuple[mujoco.MjModel, mujoco.MjData]":
        """Model and data of the present episode."""
        return self._model, self._data

    def joint_position(self) -> NDArray[np.float32]:
        return self._data.qpos[: self._num_joints].astype(np.float32)

    def object_transform(self) -> list[float]:
        return self._transform(self._bodies["object"])

    def _transform(self, body: int) -> list[float]:
        data = self._data
        return [*data.xpos[body].tolist(), *data.xquat[body].tolist()]

    def obstacle_transforms(self) -> NDArray[np.float64]:
        data, rows = self._data, self._obstacles
        return np.concatenate([data.xpos[rows], data.xquat[rows]], axis=1)

    def link_transforms(self, names: Sequence[str]) -> list[list[float]]:
        return [self._transform(self._bodies[name]) for name in names]

    def gaps(self) -> dict[str, float]:
        found = dict.fromkeys(NAME_OF_PAIR.values(), math.inf)
        for pair, distance in zip(self._pairs().tolist(), self._data.contact.dist, strict=True):
            if name := NAME_OF_PAIR.get(pair):
                found[name] = min(found[name], float(distance))
        return found

    def pack(self) -> NDArray[np.float32]:
        """See `Engine`: positions, velocities and the solver's warm start, each double in four numbers.

        Single precision holds integers of 16 bits, and so every bit of a double.
        """
        state = np.empty(mujoco.mj_stateSize(self._model, _STATE))
        mujoco.mj_getState(self._model, self._data, state, _STATE)
        return state.astype("<f8").view("<u2").astype(np.float32)

    def unpack(self, packed: NDArray[np.float32]) -> None:
        mujoco.mj_setState(self._model, self._data, _unpacked(packed), _STATE)
        mujoco.mj_step1(self._model, self._data)

    def check_packed(self, packed: NDArray[np.float32], scenario: Scenario) -> None:
        movable = self._spec.dynamic_obstacles
        free = 1 + sum(movable or o.motion is not None for o in scenario.obstacles)
        moving = (
            self._num_joints + 7 * free + self._num_joints + 6 * free
        )  # positions and velocities
        size = 4 * (moving + self._num_joints + 6 * free)
        check_vector(packed, size)
        whole = (packed >= 0) & (packed < 1 << 16) & (packed == np.floor(packed))  # False for NaN
        if not whole.all():
            raise ValueError(
                "SceneState: physics must be integers of 16 bits, four for each number, "
                f"got {packed[~whole][0]}."
            )
        state = _unpacked(packed)
        wrong = ~np.isfinite(state)
        wrong[:moving] |= ~(np.abs(state[:moving]) <= _LARGEST)
        if wrong.any():
            raise ValueError(
                f"SceneState: physics must be finite, and positions and velocities at most {_LARGEST:g}, "
                f"got {state[wrong][0]}."
            )
        first = self._num_joints
        check_quaternions(state[first : first + 7 * free].reshape(free, 7)[:, 3:])

    def picture(self) -> NDArray[np.uint8] | None:
        """See `Engine`; drawn without a renderer, in two thirds of a second."""
        return draw_picture(self._model, self._data, self._goal) if self._spec.rendered else None

    def close(self) -> None:
        """Nothing: model and data are freed with their last reference."""


def _unpacked(packed: NDArray[np.float32]) -> NDArray[np.float64]:
    return packed.astype("<u2").view("<f8").astype(np.float64)
