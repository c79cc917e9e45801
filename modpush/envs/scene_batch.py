"""`SceneBatch`: the scenes of a `PushEnv`, each in an engine of its own."""

import gc
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from modpush.envs.depth.analytic import ImageMemory
from modpush.envs.depth.base import DepthCamera, DepthCameraFactory
from modpush.envs.engines.base import CONTACT_KEYS, Engine, EngineFactory, SceneSpec, contact_looks
from modpush.envs.moving_obstacles import MovingObstacles
from modpush.envs.push_state import SceneState
from modpush.envs.robot.control import MotionConfig, MotionPlanner, PlannedMotion, start_joints
from modpush.envs.scenes.arm_room import check_arm_is_free, tool_half_extents
from modpush.envs.scenes.drawing import draw_top_view
from modpush.envs.scenes.objects import PushedObject, get_object_of
from modpush.envs.scenes.obstacle import MAX_OBSTACLES
from modpush.envs.scenes.scenario import Scenario


class Measurement(NamedTuple):
    """The present state of all scenes, as numpy arrays in the robot's base frame."""

    object_pose: NDArray[np.float64]
    """x, y, yaw of the pushed object, `[B, 3]` [m, m, rad]."""
    ee_pose: NDArray[np.float64]
    """x, y, yaw of the tool's tip, `[B, 3]` [m, m, rad]."""
    joint_position: NDArray[np.float64]
    """Angles of the arm's joints, `[B, n]` [rad]."""
    contacts: NDArray[np.bool_]
    """The contacts during the last step, `[B, 6]`, in the order of `CONTACT_KEYS`."""
    target_reachable: NDArray[np.bool_]
    """False where the commanded pose had no solution, `[B]`."""


class SceneBatch:
    """Scenes that are reset, stepped, measured and seen together, whatever engine simulates them.

    The scenes are stepped one after the other: SAPIEN holds Python's lock while it steps, so that threads
    would only wait for each other. More cores are used by several processes, each stepping a whole batch
    (`MultiSyncCollector`).

    What stays the same throughout an episode is kept in `goal_pose` `[B, 3]` [m, m, rad], whose yaw is 0
    where the goal is a position, `about_object`, the entries of `object_entries` by key, and
    `tool_half_extents` `[B, 2]` [m]. `moving` has the obstacles that move by themselves. A batch is the
    `SceneView` of its cameras. With `full_circle` yaw angles count as different at which an object looks
    the same.
    """

    def __init__(
        self,
        num_envs: int,
        make_engine: EngineFactory,
        spec: SceneSpec,
        depth: DepthCameraFactory | None,
        arm_in_depth: bool,
        full_circle: bool = False,
    ) -> None:
        self._full_circle = full_circle
        self.engines: list[Engine] = [make_engine(spec) for _ in range(num_envs)]
        self.num_envs, self._spec = num_envs, spec
        self.scenarios: list[Scenario] = []
        self.goal_pose = np.zeros((num_envs, 3))
        self.robot, self.tool, self.pushed_objects = spec.robot, spec.tool, spec.objects
        self.dynamic_obstacles = spec.dynamic_obstacles
        usual = object_entries(spec.objects[0], full_circle)
        self.about_object = {k: np.tile(v, (num_envs, 1)) for k, v in usual.items()}
        self.tool_half_extents = np.zeros((num_envs, 2))
        self._images = ImageMemory(num_envs)
        self._camera = None if depth is None else self._make_camera(depth, arm_in_depth)
        substeps = spec.sim_freq // spec.control_freq
        self._planner = MotionPlanner(spec.robot, MotionConfig(), substeps, spec.control_freq)
        self._looks = contact_looks(substeps)
        self.moving = MovingObstacles(num_envs, spec.control_freq, substeps)
        self._target, self._ee_pose = np.zeros((num_envs, 3)), np.zeros((num_envs, 3))
        self._joints = np.tile(spec.robot.home, (num_envs, 1))
        self._flange_height = np.zeros(num_envs)
        self._contacts = [[False] * len(CONTACT_KEYS) for _ in range(num_envs)]
        self._target_reachable = np.ones(num_envs, dtype=bool)
        self._plan(torch.zeros(num_envs, 3))  # compiles now, or loads what was compiled before

    def _make_camera(self, depth: DepthCameraFactory, arm_in_depth: bool) -> DepthCamera:
        camera = depth(self, arm_in_depth)
        if not isinstance(camera, DepthCamera):
            raise ValueError(
                f"PushEnv: depth must make a DepthCamera, got {camera!r} from {depth!r}."
            )
        return camera

    def start(self, indices: Sequence[int], scenarios: Sequence[Scenario]) -> None:
        """Start episodes in scenes; a ValueError is raised before anything changes."""
        joints = []
        for number, scenario in enumerate(scenarios):
            try:
                joints.append(self._start_joints(scenario))
            except ValueError as error:
                raise ValueError(f"scenarios[{number}]: {error}") from error
        for i, scenario, angles in zip(indices, scenarios, joints, strict=True):
            self.engines[i].load(scenario, angles)
            self._contacts[i] = [False] * len(CONTACT_KEYS)
            self._target_reachable[i], self.moving.steps[i] = True, 0
            self._begin_episode(i, scenario, scenario.tool_pose)
            if math.cos(self._ee_pose[i, 2] - self._target[i, 2]) < 0:
                self._target[i, 2] += math.pi  # see `Tool.half_turn`

    def _start_joints(self, scenario: Scenario) -> NDArray[np.float32]:
        item = get_object_of(self._spec.objects, scenario.pushed_object)
        spec = self._spec
        return start_joints(spec.robot, spec.tool, scenario.tool_pose, item.tool_height)

    def _begin_episode(self, i: int, scenario: Scenario, target: Sequence[float]) -> None:
        """Update all that is kept of a scene that has been put into another state."""
        if not self.scenarios:  # the first reset is of all scenes
            self.scenarios = [scenario] * self.num_envs
        self.scenarios[i] = scenario
        self.moving.begin(i, scenario.obstacles)
        item = get_object_of(self._spec.objects, scenario.pushed_object)
        self.goal_pose[i] = (*scenario.goal_position, scenario.goal_yaw or 0.0)
        for key, value in object_entries(item, self._full_circle).items():
            self.about_object[key][i] = value
        height = max((obstacle.size[2] for obstacle in scenario.obstacles), default=0.0)
        self.tool_half_extents[i] = tool_half_extents(self.tool, item.tool_height, height)
        self._target[i] = target
        self._flange_height[i] = item.tool_height + self._spec.tool.length
        self._ee_pose[i] = planar_poses(self.engines[i].link_transforms(("tip",)))[0]
        self._joints[i] = self.engines[i].joint_position()
        if self._camera is not None:
            self._camera.reset(i)

    def step(self, action: Tensor) -> None:
        """Take one control step in all scenes; action `[B, 3]` in [-1, 1]."""
        planned = self._plan(action)
        self._target, self._target_reachable = planned.target, planned.reachable
        targets = zip(planned.position.tolist(), planned.velocity.tolist(), strict=True)
        self._contacts = [
            engine.advance(angles, rates, self._looks, *self.moving.targets(i))
            for i, (engine, (angles, rates)) in enumerate(zip(self.engines, targets, strict=True))
        ]
        self.moving.steps += 1
        tips = [engine.link_transforms(("tip",))[0] for engine in self.engines]
        self._ee_pose = planar_poses(tips)
        joints = [engine.joint_position() for engine in self.engines]
        self._joints = np.array(joints, dtype=np.float64)

    def _plan(self, action: Tensor) -> PlannedMotion:
        given = self._target, self._ee_pose, self._flange_height, self._joints
        return self._planner.plan(action.double().numpy(), *given)

    def measure(self) -> Measurement:
        """The present state of all scenes."""
        return Measurement(
            object_pose=planar_poses([engine.object_transform() for engine in self.engines]),
            ee_pose=self._ee_pose,
            joint_position=self._joints,
            contacts=np.array(self._contacts),
            target_reachable=self._target_reachable,
        )

    def get_state(self, index: int) -> SceneState:
        """A copy of the state of one scene."""
        x, y, yaw = self._target[index].tolist()
        return SceneState(
            scenario=self.scenarios[index],
            physics=self.engines[index].pack(),
            target=(x, y, yaw),
            contacts=tuple(self._contacts[index]),
            target_reachable=bool(self._target_reachable[index]),
            steps=int(self.moving.steps[index]),
        )

    def check_state(self, index: int, state: SceneState) -> None:
        """Refuse a state that `set_state` could not restore; nothing changes."""
        scenario = state.scenario
        self.engines[index].check_packed(state.physics, scenario)
        self._start_joints(scenario)
        height = get_object_of(self._spec.objects, scenario.pushed_object).tool_height
        check_arm_is_free("PushEnv.set_state", scenario, height, self.tool, self.robot)

    def set_state(self, index: int, state: SceneState) -> None:
        """Put one scene into a state. The layout comes first, so that its bodies are there."""
        engine, scenario = self.engines[index], state.scenario
        engine.load(scenario, self._start_joints(scenario))
        engine.unpack(state.physics)
        self._contacts[index] = list(state.contacts)
        self._target_reachable[index] = state.target_reachable
        self.moving.steps[index] = state.steps
        self._begin_episode(index, scenario, state.target)

    def capture(self) -> tuple[Tensor, Tensor]:
        """Depth [m] and labels of all scenes, `[B, 1, H, W]` float32 and uint8."""
        depth, segmentation = self._images.take()
        camera = self._camera
        assert camera is not None
        for i in range(self.num_envs):
            given = camera.capture(i, depth[i, 0], segmentation[i, 0])
            if given is not None:
                raise TypeError(
                    f"PushEnv: depth: {type(camera).__name__}.capture must write into the arrays that it "
                    f"is given and return None, got {type(given).__name__}."
                )
        return torch.from_numpy(depth), torch.from_numpy(segmentation)

    def obstacle_entries(self) -> dict[str, Tensor]:
        """Present poses of the obstacles, and how far each has moved in its episode [m], float32.

        `obstacle_pose` `[B, MAX_OBSTACLES, 4]` is x, y, yaw and tilt [m, m, rad, rad].
        """
        poses = np.zeros((self.num_envs, MAX_OBSTACLES, 4))
        moved = np.zeros((self.num_envs, MAX_OBSTACLES))
        for i, scenario in enumerate(self.scenarios):
            if count := len(scenario.obstacles):
                now = self.obstacle_transforms_of(i)
                poses[i, :count, :3] = planar_poses(now)
                upright = 1.0 - 2.0 * np.square(now[:, 4:6]).sum(-1)  # cosine of the tilt
                poses[i, :count, 3] = np.arccos(np.clip(upright, -1.0, 1.0))
                start = np.array([o.pose[:2] for o in scenario.obstacles])
                moved[i, :count] = np.linalg.norm(now[:, :2] - start, axis=-1)
        entries = {"obstacle_displacement": moved, "obstacle_pose": poses}
        return {key: torch.from_numpy(v.astype(np.float32)) for key, v in entries.items()}

    def object_dynamics(self) -> Tensor:
        """Mass [kg], friction and centre of mass [m] of each object, `[B, 4]` float32."""
        dynamics = [scenario.dynamics for scenario in self.scenarios]
        return torch.tensor([(d.mass, d.friction, *d.center_of_mass) for d in dynamics])

    def render(self, index: int, position_tolerance: float) -> np.ndarray:
        """A picture of one scene, `[H, W, 3]` uint8: rendered from the side, or the drawn top view.

        There the disc around the goal has the radius `position_tolerance` [m].
        """
        picture = self.engines[index].picture()
        if picture is not None:
            return picture
        measured, scenario = self.measure(), self.scenarios[index]
        name = scenario.pushed_object
        return draw_top_view(
            scenario,
            measured.object_pose[index].tolist(),
            measured.ee_pose[index].tolist(),
            obstacle_poses=planar_poses(self.obstacle_transforms_of(index)),
            tool=self.tool,
            objects={name: get_object_of(self._spec.objects, name)},
            position_tolerance=position_tolerance,
        )

    def object_transform_of(self, index: int) -> NDArray[np.float64]:
        return np.array(self.engines[index].object_transform())

    def obstacle_transforms_of(self, index: int) -> NDArray[np.float64]:
        return self.engines[index].obstacle_transforms()

    def link_transforms_of(self, index: int, names: Sequence[str]) -> NDArray[np.float64]:
        return np.array(self.engines[index].link_transforms(names))

    def close(self) -> None:
        """Free the simulators."""
        for engine in self.engines:
            engine.close()
        # One collection for all of them, once nothing refers to them any more, is quicker and frees them.
        del self._camera
        self.engines = []
        gc.collect()


def object_entries(item: PushedObject, full_circle: bool) -> dict[str, NDArray[np.float64]]:
    """The entries of `PushEnv` that describe an object, by key, `[n]` each.

    With `full_circle` yaw angles count as different at which it looks the same.
    """
    return {
        "object_radius": np.array([item.radius]),
        "object_inscribed_radius": np.array([item.inscribed_radius]),
        "object_symmetry": np.array([1.0 if full_circle else float(item.symmetry)]),
        "object_support": np.asarray(item.support),
    }


def planar_poses(transforms: Sequence[Sequence[float]] | np.ndarray) -> np.ndarray:
    """x, y, yaw of `B` transforms of 7 numbers, `[B, 3]` [m, m, rad]."""
    rows = np.array(transforms)
    w, x, y, z = rows[:, 3:].T
    yaw = np.arctan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))
    return np.column_stack([rows[:, :2], yaw])
