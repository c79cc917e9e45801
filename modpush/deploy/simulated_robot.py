"""`SimulatedRobot`: an arm, a table and a depth camera in MuJoCo, in place of real ones."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modpush._types import Frequency
from modpush._validation import checked_arguments
from modpush.deploy.robot_interface import Command, RobotInterface, RobotState
from modpush.envs.engines.base import SceneSpec, contact_looks, default_sim_freq, find_engine
from modpush.envs.robot.control import MotionConfig, MotionPlanner, start_joints
from modpush.envs.robot.named import find_robot, find_tool
from modpush.envs.robot.robot import Robot, Tool
from modpush.envs.scene_batch import planar_poses
from modpush.envs.scenes.objects import PushedObject, get_object
from modpush.envs.scenes.scenario import Scenario

_HIGH = 0.15  # of the tip while the arm stands aside, over all objects [m]


class SimulatedRobot(RobotInterface):
    """The scene of an episode in a physics engine, driven as a real arm is.

    Its time passes only while a command is carried out. Beside what an arm reports it tells the truth of
    the scene, by which a run is measured: `object_pose` and `scene`.

    Args:
        scenario: Layout, object and goal.
        robot: The arm, or its name.
        tool: Its tool, or the name.
        pushed_object: The object, if it is none of the library's.
        aside: Let the arm stand aside at first, where it hides nothing, until `approach`.
        engine: Physics engine.
        sim_freq: Physics steps per second [Hz]; None for the engine's own.

    Raises:
        ValueError: If the arm cannot reach the scenario's start.
    """

    @checked_arguments
    def __init__(
        self,
        scenario: Scenario,
        robot: str | Robot = "ur5",
        tool: str | Tool = "2f85",
        pushed_object: PushedObject | None = None,
        *,
        aside: bool = False,
        engine: str = "mujoco",
        sim_freq: Frequency | None = None,
    ) -> None:
        self.scenario = scenario
        self.item = pushed_object or get_object(scenario.pushed_object)
        self.robot, self.tool = find_robot(robot), find_tool(tool)
        self._make_engine = find_engine(engine)
        self._freq = sim_freq or default_sim_freq(engine, self._make_engine)
        self._start = start_joints(self.robot, self.tool, scenario.tool_pose, self.item.tool_height)
        self._first = self._aside() if aside else self._start
        self.scene: Any = None
        """The physics engine's scene, an `Engine`; None before `connect`."""
        self.contacts = [False] * 6
        """True contacts of the last step, in the order of `CONTACT_KEYS`."""
        self.time = 0.0
        """Simulated time since `connect` [s]."""

    def _aside(self) -> NDArray[np.float32]:
        """Angles of the joints with the tool high up behind the arm, or as far round as it turns."""
        home = self.robot.tip_transform(np.array(self.robot.home), self.tool)
        x, y = home[:2, 3].tolist()
        joints = start_joints(self.robot, self.tool, (x, y, 0.0), _HIGH)
        low, high = self.robot.joints[0].limits
        joints[0] = np.clip(joints[0] + math.pi, low + 0.1, high - 0.1)
        return joints

    def connect(self) -> None:
        """Place arm, object and obstacles as the scenario says."""
        spec = SceneSpec(
            robot=self.robot,
            tool=self.tool,
            objects=(self.item,),
            sim_freq=self._freq,
            control_freq=1,  # of no meaning here: each command says how long it takes
        )
        self.scene = self._make_engine(spec)
        self.scene.load(self.scenario, self._first)
        self.time = 0.0

    def approach(self) -> None:
        """Put the tool where the scenario has it, as a person would drive it there."""
        self._scene().load(self.scenario, self._start)

    def observe(self) -> RobotState:
        return RobotState(self._scene().joint_position().astype(np.float64), self.time)

    def command(self, command: Command) -> None:
        """See `RobotInterface`; the step is the one that `PushEnv` would take."""
        substeps = max(1, round(command.duration * self._freq))
        planner = MotionPlanner(self.robot, MotionConfig(), substeps, 1 / command.duration)
        way = planner.ramp(
            command.start[None].copy(),
            command.target[None].copy(),
            np.array([command.height + self.tool.length]),
            self.observe().joints[None],
        )
        position, velocity = way.position[0].tolist(), way.velocity[0].tolist()
        self.contacts = self._scene().advance(position, velocity, contact_looks(substeps))
        self.time += substeps / self._freq

    def stop(self) -> None:
        """See `RobotInterface`: the drives hold the arm where it is."""
        if self.scene is None:
            return
        here, rest = self.observe().joints.tolist(), [0.0] * len(self.robot.joints)
        substeps = self._freq // 10
        self.scene.advance([here] * substeps, [rest] * substeps, contact_looks(substeps))
        self.time += substeps / self._freq

    def close(self) -> None:
        if self.scene is not None:
            self.scene.close()
            self.scene = None

    def _scene(self) -> Any:
        if self.scene is None:
            raise ConnectionError("the simulated arm is not connected.")
        return self.scene

    @property
    def object_pose(self) -> NDArray[np.float64]:
        """True x, y, yaw of the object, `[3]` [m, m, rad]."""
        return planar_poses([self._scene().object_transform()])[0]
