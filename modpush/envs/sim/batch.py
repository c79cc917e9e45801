"""The scenes of a `PushEnv`: many CPU tasks in one process, or one CUDA task."""

import gc
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from modpush.envs.arguments import check_scene
from modpush.envs.depth.analytic import AnalyticDepthCamera
from modpush.envs.depth.base import DepthCamera, DepthCameraFactory
from modpush.envs.depth.image_memory import ImageMemory
from modpush.envs.scenes.drawing import draw_top_view
from modpush.envs.scenes.objects import SUPPORT_DIRECTIONS
from modpush.envs.scenes.obstacle import MAX_OBSTACLES
from modpush.envs.scenes.scenario import Scenario
from modpush.envs.sim.scene_state import SceneState
from modpush.envs.sim.task import ClutterPushEnv

__all__ = ["Measurement", "SceneBatch"]


class Measurement(NamedTuple):
    """The present state of all scenes, as numpy arrays in the robot's base frame."""

    object_pose: NDArray[np.float64]
    """x, y, yaw of the pushed object, `[B, 3]` [m, m, rad]."""
    ee_pose: NDArray[np.float64]
    """x, y, yaw of the tool's tip, `[B, 3]` [m, m, rad]."""
    joint_position: NDArray[np.float64]
    """Angles of the arm's joints, `[B, 6]` [rad]."""
    contacts: NDArray[np.bool_]
    """What touched during the last step, `[B, 6]`, in the order of `CONTACT_KEYS`."""
    target_reachable: NDArray[np.bool_]
    """False where the commanded pose had no solution, `[B]`."""


class SceneBatch(ABC):
    """Scenes that are reset, stepped and measured together.

    What stays the same throughout an episode is kept in `goal_position` `[B, 2]` [m],
    `object_radius` and `object_inscribed_radius` `[B, 1]` [m], `object_symmetry` `[B, 1]`, and
    `object_support` `[B, SUPPORT_DIRECTIONS]` [m].

    Args:
        tasks: One task for each scene, or one task that holds all scenes.
        depth: What makes the depth camera of a task, or None.
        arm_in_depth: Whether the depth camera sees the arm.
    """

    def __init__(
        self,
        tasks: Sequence[ClutterPushEnv],
        depth: DepthCameraFactory | None,
        arm_in_depth: bool,
    ) -> None:
        self.tasks = list(tasks)
        self.num_envs = sum(task.num_envs for task in tasks)
        self.goal_position = np.zeros((self.num_envs, 2))
        self.object_radius = np.zeros((self.num_envs, 1))
        self.object_inscribed_radius = np.zeros((self.num_envs, 1))
        self.object_symmetry = np.zeros((self.num_envs, 1))
        self.object_support = np.zeros((self.num_envs, SUPPORT_DIRECTIONS))
        self._images = ImageMemory(self.num_envs)
        self._analytic = [AnalyticDepthCamera(task, arm_in_depth) for task in tasks]
        self._cameras: Sequence[DepthCamera] = self._analytic
        if depth not in (AnalyticDepthCamera, None):
            self._cameras = [_make_camera(depth, task, arm_in_depth) for task in tasks]

    @abstractmethod
    def start(self, indices: Sequence[int], scenarios: Sequence[Scenario]) -> None:
        """Start episodes in the scenes of these indices."""

    @abstractmethod
    def step(self, action: Tensor) -> None:
        """Take one control step in all scenes; action `[B, 3]` in [-1, 1]."""

    @abstractmethod
    def measure(self) -> Measurement:
        """The present state of all scenes."""

    @abstractmethod
    def get_state(self, index: int) -> SceneState:
        """A copy of the state of one scene."""

    @abstractmethod
    def check_state(self, index: int, state: SceneState) -> None:
        """Refuse a state that `set_state` could not restore; nothing changes."""

    @abstractmethod
    def set_state(self, index: int, state: SceneState) -> None:
        """Put one scene into a state."""

    def _locate(self, index: int) -> tuple[int, int]:
        """Which task a scene is in, and its index there."""
        return (index, 0) if len(self.tasks) > 1 else (0, index)

    def _begin_episode(self, index: int) -> None:
        """Store the constants of an episode that has just started, and draw its fixed bodies."""
        number, i = self._locate(index)
        scenario = self.scenario(index)
        item = self.tasks[number].objects.item(scenario.pushed_object)
        self.goal_position[index] = scenario.goal_position
        self.object_radius[index] = item.radius
        self.object_inscribed_radius[index] = item.inscribed_radius
        self.object_symmetry[index] = item.symmetry
        self.object_support[index] = item.support
        self._analytic[number].reset(i)
        if self._cameras is not self._analytic:
            self._cameras[number].reset(i)

    def capture(self) -> tuple[Tensor, Tensor]:
        """Depth [m] and labels of all scenes, `[B, 1, H, W]` float32 and uint8."""
        depth, segmentation = self._images.take()
        for index in range(self.num_envs):
            number, i = self._locate(index)
            camera: Any = self._cameras[number]
            given = camera.capture(i, depth[index, 0], segmentation[index, 0])
            if given is not None:
                raise TypeError(
                    f"PushEnv: depth: {type(camera).__name__}.capture must write into the arrays that it "
                    f"is given and return None, got {type(given).__name__}."
                )
        return torch.from_numpy(depth), torch.from_numpy(segmentation)

    def cast(self, index: int, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Depth [m] and label at single pixels `[..., 2]` (u, v) of one scene's image."""
        check_scene("PushEnv.cast", index, self.num_envs)
        number, i = self._locate(index)
        return self._analytic[number].cast(i, pixels)

    def scenario(self, index: int) -> Scenario:
        """What the present episode of one scene started from."""
        number, i = self._locate(index)
        return self.tasks[number].scenarios[i]

    def obstacle_displacement(self) -> Tensor:
        """How far each obstacle has moved in its episode, `[B, MAX_OBSTACLES]` float32 [m]."""
        moved = np.zeros((self.num_envs, MAX_OBSTACLES))
        for index in range(self.num_envs):
            number, i = self._locate(index)
            start = np.array([o.pose[:2] for o in self.scenario(index).obstacles])
            if len(start):
                now = self.tasks[number].obstacles.transforms(i)[:, :2]
                moved[index, : len(start)] = np.linalg.norm(now - start, axis=-1)
        return torch.from_numpy(moved.astype(np.float32))

    def render(self, index: int) -> np.ndarray:
        """A picture of one scene, `[H, W, 3]` uint8: rendered from the side, or the drawn top view."""
        check_scene("PushEnv.render", index, self.num_envs)
        number, i = self._locate(index)
        task = self.tasks[number]
        if task.scene.can_render():
            return task.render_rgb_array()[i].cpu().numpy()
        measured, scenario = self.measure(), self.scenario(index)
        return draw_top_view(
            scenario,
            measured.object_pose[index].tolist(),
            measured.ee_pose[index].tolist(),
            obstacle_poses=planar_poses(task.obstacles.transforms(i)),
            tool=task.agent.tool_name,
            objects={scenario.pushed_object: task.objects.item(scenario.pushed_object)},
        )

    def close(self) -> None:
        """Free the simulators."""
        for task in self.tasks:
            if task.gpu_sim_enabled:
                task.close()
        # On a CPU a task's `close` would collect garbage while the task still holds its bodies: one
        # collection for all of them, once nothing refers to them any more, is quicker and frees them.
        self.tasks, self._cameras, self._analytic = [], [], []
        gc.collect()


def _make_camera(
    depth: DepthCameraFactory, task: ClutterPushEnv, arm_in_depth: bool
) -> DepthCamera:
    camera = depth(task, arm_in_depth)
    if not isinstance(camera, DepthCamera):
        raise ValueError(f"PushEnv: depth must make a DepthCamera, got {camera!r} from {depth!r}.")
    return camera


def planar_poses(transforms: Sequence[Sequence[float]] | np.ndarray) -> np.ndarray:
    """x, y, yaw of `B` transforms of 7 numbers, `[B, 3]` [m, m, rad]."""
    rows = np.array(transforms)
    w, x, y, z = rows[:, 3:].T
    yaw = np.arctan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))
    return np.column_stack([rows[:, :2], yaw])
