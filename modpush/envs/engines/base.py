"""`Engine`: the boundary between the library and a physics engine, and the engines by name."""

import functools
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from modpush._extras import require_extra
from modpush.envs.robot.robot import Robot, Tool
from modpush.envs.scenes.objects import PushedObject
from modpush.envs.scenes.scenario import Scenario
from modpush.parts import check_part, find_part

FRICTION: dict[str, float] = {"object": 0.5, "table": 0.5, "obstacle": 0.5, "tool": 0.0}
"""Friction coefficient of each material. A pair has the mean of two, so that it is 0.5 between object
and table, 0.25 between tool and object, and 0.5 between object and obstacle."""
ROBOT, OBJECT, OBSTACLE, TABLE = 1, 2, 4, 8
"""Categories of bodies, by which contacts are told apart; a pair is the sum of two."""
PAIRS = (ROBOT | OBJECT, OBJECT | OBSTACLE, ROBOT | OBSTACLE)
"""The pairs that `CONTACT_KEYS` are about, in their order."""
NAME_OF_PAIR = {
    **dict(zip(PAIRS, ("robot_object", "object_obstacle", "robot_obstacle"), strict=True)),
    OBJECT | TABLE: "object_table",
}
"""Keys of `Engine.gaps`."""
CONTACT_GAP = 0.001
"""Bodies whose surfaces are nearer than this count as touching [m]."""

CONTACT_KEYS = (
    "object_contact",
    "obstacle_contact",
    "tool_obstacle_contact",
    "object_contact_at_end",
    "obstacle_contact_at_end",
    "tool_obstacle_contact_at_end",
)
"""During a control step tool or arm touched the object; the object touched an obstacle; tool or arm
touched an obstacle; and the same three at the step's end."""

_LOOKS = 4


@functools.cache
def contact_looks(num_substeps: int) -> frozenset[int]:
    """The physics steps of a control step, counted from 1, after which contacts are read: four."""
    return frozenset(round(num_substeps * (i + 1) / _LOOKS) for i in range(_LOOKS))


@dataclass(frozen=True, kw_only=True)
class SceneSpec:
    """The properties of a scene that are the same in all of its episodes."""

    robot: Robot
    """Arm."""
    tool: Tool
    """Tool of the arm."""
    objects: tuple[PushedObject, ...]
    """The objects of which an episode pushes one."""
    sim_freq: int
    """Physics steps per second [Hz]."""
    control_freq: int
    """Control steps per second [Hz], a divisor of `sim_freq`."""
    dynamic_obstacles: bool = False
    """Obstacles can be moved; each has the mass `OBSTACLE_MASS`."""
    rendered: bool = False
    """Pictures are asked for; build the scene with a renderer if they need one."""


class Engine(ABC):
    """One scene in a physics engine. Implement all methods to run the library on another engine.

    Frictions are those of `FRICTION`, links and drives those of the robot, which stands at `Robot.base`.
    A transform is a position [m] and a quaternion (w, x, y, z) in the robot's base frame. Two scenes that
    were loaded with the same scenario and get the same targets behave alike to the last bit, whatever
    happened in them before.
    """

    name: ClassVar[str]
    """Name of the engine, which a state of a scene belongs to."""
    version: ClassVar[str]
    """Version of the engine."""
    default_sim_freq: ClassVar[int]
    """Physics steps per second at which the engine is accurate enough [Hz]."""

    @abstractmethod
    def load(self, scenario: Scenario, joints: NDArray[np.float32]) -> None:
        """Begin an episode: place object, obstacles and arm, at rest but for `Obstacle.motion`.

        Args:
            scenario: Layout, object and goal.
            joints: Angles of the arm's joints, `[n]` [rad].

        Raises:
            ValueError: If the object is none of the scene's; nothing has changed then.
        """

    @abstractmethod
    def advance(
        self,
        position: Sequence[Sequence[float]],
        velocity: Sequence[Sequence[float]],
        looks: Collection[int],
        obstacles: NDArray[np.float64] | None = None,
    ) -> list[bool]:
        """Take one control step.

        Args:
            position: Targets of the joint drives for each of `S` physics steps, `[S][n]` [rad].
            velocity: Velocity targets in the same form [rad/s].
            looks: Physics steps, counted from 1, after which contacts are read; the last one is `S`.
            obstacles: Place of the centre (x, y) [m] and velocity (x, y) [m/s] at the end of each physics
                step of the `m` obstacles that move by themselves, `[S, m, 4]`; not given where none does.
                They push what is in their way and are not stopped by it.

        Returns:
            The contacts, in the order of `CONTACT_KEYS`: the first three at any look, the others at the
            last one.
        """

    @abstractmethod
    def joint_position(self) -> NDArray[np.float32]:
        """Angles of the arm's joints, `[n]` [rad]."""

    @abstractmethod
    def object_transform(self) -> Sequence[float]:
        """Transform of the pushed object, 7 numbers."""

    @abstractmethod
    def obstacle_transforms(self) -> NDArray[np.float64]:
        """Transforms of the obstacles in the order of the layout, `[n, 7]`."""

    @abstractmethod
    def link_transforms(self, names: Sequence[str]) -> Sequence[Sequence[float]]:
        """Transforms of links of the arm; beside the robot's there are `tool` and `tip`."""

    @abstractmethod
    def gaps(self) -> dict[str, float]:
        """Smallest distance of surfaces now [m], negative where bodies overlap, by the pair of bodies.

        The pairs are `robot_object`, `object_obstacle`, `robot_obstacle` and `object_table`; a distance
        that the engine does not know, since the bodies are far apart, is infinite.
        """

    @abstractmethod
    def pack(self) -> NDArray[np.float32]:
        """The state of all bodies and drives, as one vector."""

    @abstractmethod
    def unpack(self, packed: NDArray[np.float32]) -> None:
        """Inverse of `pack`, after `load` of the same scenario."""

    @abstractmethod
    def check_packed(self, packed: NDArray[np.float32], scenario: Scenario) -> None:
        """Refuse a vector that cannot be a state of this scene with a scenario; nothing changes.

        Raises:
            ValueError: If it cannot.
        """

    def picture(self) -> NDArray[np.uint8] | None:
        """A picture from the side, `[H, W, 3]`; None where `SceneSpec.rendered` is False."""
        return None

    @abstractmethod
    def close(self) -> None:
        """Free the simulator."""


EngineFactory = Callable[[SceneSpec], Engine]
"""Makes one scene; the class of an engine is one."""


def check_vector(packed: Any, size: int) -> None:
    """Refuse a packed state of another type or size."""
    if not isinstance(packed, np.ndarray) or (packed.dtype, packed.shape) != (np.float32, (size,)):
        got = f"{getattr(packed, 'dtype', type(packed).__name__)} of shape {np.shape(packed)}"
        raise ValueError(f"SceneState: physics must be float32 of shape ({size},), got {got}.")


def check_quaternions(quaternions: NDArray[Any]) -> None:
    """Refuse quaternions in a packed state, `[n, 4]`, that are not of length 1."""
    lengths = np.linalg.norm(quaternions, axis=1)
    if (np.abs(lengths - 1) > 1e-3).any():
        raise ValueError(f"SceneState: quaternions in physics must be of length 1, got {lengths}.")


@dataclass(frozen=True, kw_only=True)
class ShippedEngine:
    """An engine of the library; nothing of it is imported before it is used."""

    factory: str
    """Its factory, as `module:name`."""
    sim_freq: int
    """Physics steps per second at which it is accurate enough [Hz]."""
    packages: tuple[str, ...] = ()
    """Packages that it needs and that an extra brings."""


ENGINES: dict[str, ShippedEngine] = {
    "sapien": ShippedEngine(
        factory="modpush.envs.engines.sapien.engine:SapienEngine.build", sim_freq=120
    ),
    "mujoco": ShippedEngine(
        factory="modpush.envs.engines.mujoco.engine:MujocoEngine",
        sim_freq=480,
        packages=("mujoco",),
    ),
}
"""The shipped engines by name."""


def check_engine(who: str, engine: Any) -> None:
    """Refuse what cannot be an engine, without importing anything; `who` has it, for the error."""
    check_part(f"{who}: engine", engine, ENGINES)


def find_engine(engine: str | EngineFactory) -> EngineFactory:
    """Factory of an engine's scenes, by name, by `"module:name"`, or passed through.

    Raises:
        ValueError: If there is no such engine (the known ones are listed), or if it cannot be called.
        MissingExtraError: If a package is not installed that the engine needs; the message names it.
    """
    found: Any = find_part("engine", engine, ENGINES)
    if isinstance(found, ShippedEngine):
        require_extra(f"PushEnv: engine {engine!r}", *found.packages)
        found = find_part("engine", found.factory, {})
    if not callable(found):
        raise ValueError(
            "PushEnv: engine must be an Engine's class or a function (spec) -> Engine, got "
            f"{found!r}."
        )
    return found


def default_sim_freq(engine: str | EngineFactory, factory: EngineFactory) -> int:
    """Physics steps per second where none are given [Hz], of an engine and what `find_engine` found.

    Raises:
        ValueError: If a function was given, which has no rate of its own.
    """
    if isinstance(engine, str) and engine in ENGINES:
        return ENGINES[engine].sim_freq
    rate = getattr(factory, "default_sim_freq", None)
    if rate is None:
        raise ValueError(
            f"PushEnv: sim_freq must be given with the engine {engine!r}, which has no "
            "default_sim_freq, got None."
        )
    return int(rate)
