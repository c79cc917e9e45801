"""Scenes on a CPU, stepped one after the other in this process."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from modpush.envs.depth.base import DepthCameraFactory
from modpush.envs.robot.control_cpu import plan_motion_cpu
from modpush.envs.scenes.scenario import Scenario
from modpush.envs.sim.batch import Measurement, SceneBatch, planar_poses
from modpush.envs.sim.scene_state import SceneState, check_packed
from modpush.envs.sim.task import ClutterPushEnv

__all__ = ["CpuBatch"]


class CpuBatch(SceneBatch):
    """As many one-scene tasks as there are scenes.

    SAPIEN holds Python's lock while it steps, so that threads would only wait for each other. More
    cores are used by several processes, each stepping a whole batch (`MultiSyncCollector`).

    Args:
        num_envs: Number of scenes.
        depth: What makes the depth camera of a task, or None.
        arm_in_depth: Whether the depth camera sees the arm.
        **task: Arguments of `ClutterPushEnv`.
    """

    def __init__(
        self, num_envs: int, depth: DepthCameraFactory | None, arm_in_depth: bool, **task: Any
    ) -> None:
        tasks = [ClutterPushEnv(obs_mode="none", **task) for _ in range(num_envs)]
        super().__init__(tasks, depth, arm_in_depth)
        self._scenes = [task.cpu_scene for task in tasks if task.cpu_scene is not None]
        first = tasks[0]
        self._motion = first.agent.motion
        self._num_substeps = first.sim_freq // first.control_freq
        self._control_freq = first.control_freq
        self._target, self._ee_pose = np.zeros((num_envs, 3)), np.zeros((num_envs, 3))
        self._flange_height = np.zeros(num_envs)
        self._target_reachable = np.ones(num_envs, dtype=bool)
        self._plan(torch.zeros(num_envs, 3))  # compiles now, or loads what was compiled before

    def start(self, indices: Sequence[int], scenarios: Sequence[Scenario]) -> None:
        """See `SceneBatch`."""
        for i, scenario in zip(indices, scenarios, strict=True):
            self._scenes[i].start_joints(scenario)  # raises before any scene has been changed
        for i, scenario in zip(indices, scenarios, strict=True):
            self.tasks[i].start(scenario)
            self._after_change(i, scenario, scenario.tool_pose)
            self._target_reachable[i] = True

    def _after_change(self, i: int, scenario: Scenario, target: Sequence[float]) -> None:
        """Update all that is kept of a scene whose task has been put into another state."""
        task = self.tasks[i]
        item = task.objects.item(scenario.pushed_object)
        self._target[i] = target
        self._flange_height[i] = item.tool_height + task.agent.tool.length
        self._begin_episode(i)
        self._ee_pose[i] = planar_poses(self._scenes[i].link_transforms(("tip",)))[0]

    def step(self, action: Tensor) -> None:
        """See `SceneBatch`."""
        self._target, position, velocity, self._target_reachable = self._plan(action)
        for scene, angles, rates in zip(
            self._scenes, position.tolist(), velocity.tolist(), strict=True
        ):
            scene.advance(angles, rates)
        tips = [scene.link_transforms(("tip",))[0] for scene in self._scenes]
        self._ee_pose = planar_poses(tips)

    def _plan(
        self, action: Tensor
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
        return plan_motion_cpu(
            action.double().numpy(),
            self._target,
            self._ee_pose,
            self._flange_height,
            self._motion,
            self._num_substeps,
            self._control_freq,
        )

    def measure(self) -> Measurement:
        """See `SceneBatch`."""
        return Measurement(
            object_pose=planar_poses([scene.object_transform() for scene in self._scenes]),
            ee_pose=self._ee_pose,
            joint_position=np.array(
                [scene.joint_position() for scene in self._scenes], dtype=np.float64
            ),
            contacts=np.array([scene.contacts.touched for scene in self._scenes]),
            target_reachable=self._target_reachable,
        )

    def get_state(self, index: int) -> SceneState:
        """See `SceneBatch`."""
        scene = self._scenes[index]
        x, y, yaw = self._target[index].tolist()
        return SceneState(
            scenario=self.scenario(index),
            physics=np.frombuffer(scene.physics.pack(), dtype=np.float32),
            target=(x, y, yaw),
            contacts=tuple(scene.contacts.touched),
            target_reachable=bool(self._target_reachable[index]),
        )

    def check_state(self, index: int, state: SceneState) -> None:
        """See `SceneBatch`."""
        movable = len(state.scenario.obstacles) if self.tasks[index].dynamic_obstacles else 0
        check_packed(state.physics, 1 + movable)
        self._scenes[index].start_joints(state.scenario)

    def set_state(self, index: int, state: SceneState) -> None:
        """See `SceneBatch`. The layout comes first, so that PhysX's packed state finds all bodies."""
        scene = self._scenes[index]
        self.tasks[index].start(state.scenario)
        scene.physics.unpack(state.physics.tobytes())
        scene.contacts.touched = list(state.contacts)
        self._after_change(index, state.scenario, state.target)
        self._target_reachable[index] = state.target_reachable

    def close(self) -> None:
        """See `SceneBatch`."""
        self._scenes = []
        super().close()
