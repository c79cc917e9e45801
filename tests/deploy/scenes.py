"""Scenes in MuJoCo with a tilted depth camera, for the tests of perception."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from modpush.envs.depth.stereo_noise import stereo_noise
from modpush.envs.engines.base import SceneSpec
from modpush.envs.engines.mujoco.engine import MujocoEngine
from modpush.envs.engines.mujoco.rendering import DepthRenderer
from modpush.envs.robot.control import start_joints
from modpush.envs.robot.named import ROBOTS, TOOLS
from modpush.envs.scenes.objects import OBJECTS
from modpush.envs.scenes.obstacle import Obstacle
from modpush.envs.scenes.scenario import Scenario
from modpush.geometry import CameraModel

TILT = math.radians(30.0)
ASIDE = math.radians(30.0)
CAMERA = CameraModel.looking_at(
    (0.5, 0.0, 0.0),
    (
        0.5 + math.sin(TILT) * math.cos(ASIDE),
        math.sin(TILT) * math.sin(ASIDE),
        math.cos(TILT),
    ),
)
"""1 m from the middle of the workspace, 30 degrees from the vertical, in front of the arm to its left."""
FAR_AWAY = (0.25, -0.30, 0.0)
"""A pose of the tool beside which the object is in view."""
ROBOT, TOOL = ROBOTS["ur5"], TOOLS["2f85"]


class Bench:
    """An arm, an object and obstacles, and images of them."""

    def __init__(self, camera: CameraModel = CAMERA, method: str = "auto") -> None:
        spec = SceneSpec(
            robot=ROBOT,
            tool=TOOL,
            objects=tuple(OBJECTS.values()),
            sim_freq=480,
            control_freq=15,
        )
        self.engine, self.renderer = MujocoEngine(spec), DepthRenderer(camera, method)
        self.rng = np.random.default_rng(0)

    def load(
        self,
        name: str,
        object_pose: Sequence[float],
        tool_pose: Sequence[float] = FAR_AWAY,
        obstacles: Sequence[Obstacle] = (),
    ) -> NDArray[np.float64]:
        """Begin a scene; returns the joints' angles."""
        scenario = Scenario(
            scene="slot",
            difficulty=0.5,
            obstacles=tuple(obstacles),
            pushed_object=name,
            object_pose=tuple(object_pose),
            goal_position=(0.6, 0.0),
            tool_pose=tuple(tool_pose),
        )
        self.height = OBJECTS[name].tool_height
        joints = start_joints(ROBOT, TOOL, tool_pose, self.height)
        self.engine.load(scenario, joints)
        return joints.astype(np.float64)

    def move(self, joints: NDArray[np.float64], tool_pose: Sequence[float]) -> NDArray[np.float64]:
        """One control step of the tool to a pose near by; returns the joints' angles."""
        x, y, yaw = tool_pose
        flange = np.array([[x, y, self.height + TOOL.length, yaw]])
        (target,), _ = ROBOT.inverse(flange, joints[None])
        steps = 480 // 15
        share = np.arange(1, steps + 1)[:, None] / steps
        rate = np.tile((target - joints) * 15.0, (steps, 1))
        self.engine.advance(joints + share * (target - joints), rate, {steps})
        return self.engine.joint_position().astype(np.float64)

    def image(self, noise: bool = True) -> NDArray[np.float32]:
        """The camera's present image."""
        exact = self.renderer(self.engine)
        return stereo_noise(exact, self.rng) if noise else exact

    def object_pose(self) -> NDArray[np.float64]:
        """The object's true pose, `[3]`."""
        x, y, _, w, _, _, z = self.engine.object_transform()
        return np.array([x, y, 2 * math.atan2(z, w)])


def yaw_apart(one: float, other: float, symmetry: int) -> float:
    """Angle between two yaws, up to those at which an object looks the same [rad]."""
    if symmetry == 0:
        return 0.0
    turn = 2 * math.pi / symmetry
    return abs((one - other + turn / 2) % turn - turn / 2)
