"""A batch of scenes to step: many CPU tasks in one process, or one CUDA task."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from modpush.envs.depth.cameras import (
    AnalyticDepthCamera,
    DepthCamera,
    DepthName,
    make_depth_camera,
)
from modpush.envs.robot.control import plan_motion_cpu
from modpush.envs.scenes.objects import get_object_of
from modpush.envs.scenes.scenario import Scenario
from modpush.envs.sim.task import ClutterPushEnv, choose_render_backend

__all__ = ["Batch", "CpuBatch", "CudaBatch", "Reading", "SceneState", "make_batch"]


class Reading(NamedTuple):
    """The truth of the scenes, on the host; metres and radians."""

    object_pose: NDArray[np.float64]
    """`[B, 3]`"""
    ee_pose: NDArray[np.float64]
    """`[B, 3]`"""
    joint_position: NDArray[np.float64]
    """`[B, 6]`"""
    contacts: NDArray[np.bool_]
    """`[B, 3]`, in the order of `CONTACT_KEYS`"""
    reachable: NDArray[np.bool_]
    """`[B]`"""


@dataclass(frozen=True)
class SceneState:
    """All of one scene that the future depends on."""

    scenario: Scenario
    physics: Any
    """PhysX's own state on a CPU, ManiSkill's state dictionary on CUDA."""
    target: tuple[float, float, float]
    """The controller's commanded pose."""
    contacts: tuple[bool, bool, bool]
    reachable: bool


class Batch(ABC):
    """Scenes that are reset, stepped and read together."""

    tasks: list[ClutterPushEnv]
    device: torch.device

    @abstractmethod
    def start(self, indices: Sequence[int], scenarios: Sequence[Scenario]) -> None:
        """Start episodes in the scenes of these indices."""

    @abstractmethod
    def step(self, action: Tensor) -> None:
        """One control step of all scenes; action `[B, 3]` in [-1, 1]."""

    @abstractmethod
    def read(self) -> Reading:
        """The present state of all scenes."""

    @abstractmethod
    def capture(self, index: int, depth: np.ndarray, segmentation: np.ndarray) -> None:
        """Write the image of one scene into `[H, W]` arrays."""

    @abstractmethod
    def cast(self, index: int, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Depth and label at single pixels of one scene's image, without drawing it."""

    @abstractmethod
    def scenario(self, index: int) -> Scenario:
        """What the present episode of one scene started from."""

    @abstractmethod
    def obstacle_positions(self, index: int) -> np.ndarray:
        """Where the obstacles of one scene are now, `[n, 2]` [m]."""

    @abstractmethod
    def get_state(self, index: int) -> SceneState:
        """A copy of the state of one scene."""

    @abstractmethod
    def set_state(self, index: int, state: SceneState) -> None:
        """Put one scene into a state."""

    def close(self) -> None:
        """Free the simulators."""
        for task in self.tasks:
            task.close()
        self.tasks = []


class CpuBatch(Batch):
    """As many one-scene tasks as there are scenes, stepped one after the other in this process.

    SAPIEN holds Python's lock while it steps, so threads would only wait for each other; what
    scales over cores is processes that step through whole batches (`MultiSyncCollector`).
    """

    def __init__(
        self, num_envs: int, depth: DepthName | None, arm_in_depth: bool, **task: Any
    ) -> None:
        self.device = torch.device("cpu")
        self.tasks = [ClutterPushEnv(obs_mode="none", **task) for _ in range(num_envs)]
        self._casters = [AnalyticDepthCamera(task, arm_in_depth) for task in self.tasks]
        self._cameras: Sequence[DepthCamera] = (
            self._casters
            if depth in ("analytic", None)
            else [make_depth_camera(depth, task, arm_in_depth) for task in self.tasks]
        )
        self._scenes = [task.cpu_scene for task in self.tasks if task.cpu_scene is not None]
        first = self.tasks[0]
        self._motion = first.agent.motion
        self._substeps, self._control_freq = first._sim_steps_per_control, first.control_freq
        self._target, self._ee_pose = np.zeros((num_envs, 3)), np.zeros((num_envs, 3))
        self._height, self._reachable = np.zeros(num_envs), np.ones(num_envs, dtype=bool)
        self._plan(torch.zeros(num_envs, 3))  # compiles, or loads what was compiled before

    def start(self, indices: Sequence[int], scenarios: Sequence[Scenario]) -> None:
        """See `Batch`."""
        for i, scenario in zip(indices, scenarios, strict=True):
            self.tasks[i].start(scenario)
            self._settle(i, scenario, scenario.tool_pose)
            self._reachable[i] = True

    def _settle(self, i: int, scenario: Scenario, target: Sequence[float]) -> None:
        """Point the controller and the cameras at a scene that has just changed."""
        task = self.tasks[i]
        item = get_object_of(task.pushed_objects, scenario.pushed_object)
        self._target[i] = target
        self._height[i] = item.tool_height + task.agent.tool.length
        self._casters[i].reset(0)
        if self._cameras[i] is not self._casters[i]:
            self._cameras[i].reset(0)
        self._ee_pose[i] = _planar(self._scenes[i].link_transforms(("tip",)))[0]

    def step(self, action: Tensor) -> None:
        """See `Batch`."""
        self._target, position, velocity, self._reachable = self._plan(action)
        for scene, angles, rates in zip(
            self._scenes, position.tolist(), velocity.tolist(), strict=True
        ):
            scene.advance(angles, rates)
        self._ee_pose = _planar([scene.link_transforms(("tip",))[0] for scene in self._scenes])

    def _plan(self, action: Tensor) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        return plan_motion_cpu(
            action.double().numpy(),
            self._target,
            self._ee_pose,
            self._height,
            self._motion,
            self._substeps,
            self._control_freq,
        )

    def read(self) -> Reading:
        """See `Batch`."""
        return Reading(
            _planar([scene.object_transform() for scene in self._scenes]),
            self._ee_pose,
            np.array([scene.joint_position() for scene in self._scenes], dtype=np.float64),
            np.array([task.contacts.row for task in self.tasks]),
            self._reachable,
        )

    def capture(self, index: int, depth: np.ndarray, segmentation: np.ndarray) -> None:
        """See `Batch`."""
        self._cameras[index].capture(0, depth, segmentation)

    def cast(self, index: int, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `Batch`."""
        return self._casters[index].cast(0, pixels)

    def scenario(self, index: int) -> Scenario:
        """See `Batch`."""
        return self.tasks[index].scenarios[0]

    def obstacle_positions(self, index: int) -> np.ndarray:
        """See `Batch`."""
        return self.tasks[index].obstacles.transforms(0)[:, :2]

    def get_state(self, index: int) -> SceneState:
        """See `Batch`."""
        task = self.tasks[index]
        x, y, yaw = self._target[index].tolist()
        first, second, third = task.contacts.row
        return SceneState(
            scenario=task.scenarios[0],
            physics=task.scene.px.pack(),
            target=(x, y, yaw),
            contacts=(first, second, third),
            reachable=bool(self._reachable[index]),
        )

    def set_state(self, index: int, state: SceneState) -> None:
        """See `Batch`. Bodies first, so that PhysX's packed state finds them all."""
        task = self.tasks[index]
        task.start(state.scenario)
        task.scene.px.unpack(state.physics)
        task.contacts.row = list(state.contacts)
        self._settle(index, state.scenario, state.target)
        self._reachable[index] = state.reachable


def _planar(transforms: Sequence[Sequence[float]]) -> NDArray[np.float64]:
    """x, y, yaw of `B` transforms of 7 numbers, `[B, 3]`."""
    rows = np.array(transforms)
    w, x, y, z = rows[:, 3:].T
    yaw = np.arctan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))
    return np.column_stack([rows[:, :2], yaw])


class CudaBatch(Batch):
    """One ManiSkill task that holds all scenes on a GPU. Images are still made on the CPU."""

    def __init__(
        self, num_envs: int, depth: DepthName | None, arm_in_depth: bool, **task: Any
    ) -> None:
        self._task = ClutterPushEnv(
            obs_mode="none", num_envs=num_envs, sim_backend="physx_cuda", **task
        )
        self.tasks = [self._task]
        self.device = self._task.device
        self._caster = AnalyticDepthCamera(self._task, arm_in_depth)
        self._camera = (
            self._caster
            if depth in ("analytic", None)
            else make_depth_camera(depth, self._task, arm_in_depth)
        )

    def start(self, indices: Sequence[int], scenarios: Sequence[Scenario]) -> None:
        """See `Batch`."""
        rows = torch.as_tensor(indices, device=self.device)
        self._task.reset(options={"env_idx": rows, "scenarios": list(scenarios)})
        for i in indices:
            self._camera.reset(i)
            self._caster.reset(i)

    def step(self, action: Tensor) -> None:
        """See `Batch`."""
        self._task.step(action.float())

    def read(self) -> Reading:
        """See `Batch`."""
        task = self._task
        tensors = (
            task.object_pose,
            task.ee_pose,
            task.agent.robot.get_qpos().double(),
            torch.stack(list(task.contacts.flags().values()), -1),
            task.agent.controller.reachable,
        )
        return Reading(*(tensor.cpu().numpy() for tensor in tensors))

    def capture(self, index: int, depth: np.ndarray, segmentation: np.ndarray) -> None:
        """See `Batch`."""
        self._camera.capture(index, depth, segmentation)

    def cast(self, index: int, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """See `Batch`."""
        return self._caster.cast(index, pixels)

    def scenario(self, index: int) -> Scenario:
        """See `Batch`."""
        return self._task.scenarios[index]

    def obstacle_positions(self, index: int) -> np.ndarray:
        """See `Batch`."""
        return self._task.obstacles.transforms(index)[:, :2]

    def get_state(self, index: int) -> SceneState:
        """See `Batch`."""
        task = self._task
        controller = task.agent.controller
        x, y, yaw = controller.target[index].tolist()
        first, second, third = (bool(v[index]) for v in task.contacts.flags().values())
        physics = _rows(task.get_state_dict(), index)
        return SceneState(
            scenario=task.scenarios[index],
            physics=physics,
            target=(x, y, yaw),
            contacts=(first, second, third),
            reachable=bool(controller.reachable[index]),
        )

    def set_state(self, index: int, state: SceneState) -> None:
        """See `Batch`."""
        self.start([index], [state.scenario])
        rows = torch.tensor([index], device=self.device)
        task, controller = self._task, self._task.agent.controller
        physics = {k: v for k, v in state.physics.items() if k != "controller"}
        task.set_state_dict(physics, rows)
        controller.target[index] = controller.target.new_tensor(state.target)
        controller.reachable[index] = state.reachable


def _rows(state: Any, index: int) -> Any:
    """One scene's rows of a nested dictionary of tensors, copied."""
    if isinstance(state, dict):
        return {key: _rows(value, index) for key, value in state.items()}
    return state[index : index + 1].clone()


def make_batch(
    num_envs: int,
    device: torch.device,
    depth: DepthName | None,
    arm_in_depth: bool,
    pictures: bool,
    **task: Any,
) -> Batch:
    """The batch for a device; with a renderer only where pictures are asked for."""
    task["render_backend"] = choose_render_backend() if pictures or depth == "sapien" else "none"
    kind = CudaBatch if device.type == "cuda" else CpuBatch
    return kind(num_envs, depth, arm_in_depth, **task)
