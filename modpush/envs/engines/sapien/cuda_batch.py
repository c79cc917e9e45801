"""Scenes in one batched simulation on CUDA. Experimental: it has never been run.

`make test-gpu` is the command that would prove it.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import sapien
import torch
from torch import Tensor

from modpush._extras import warn_experimental
from modpush.envs.engines.base import SceneSpec
from modpush.envs.engines.sapien.task import PushTask
from modpush.envs.push_state import SceneState
from modpush.envs.scene_batch import Measurement, SceneBatch, planar_poses
from modpush.envs.scenes.scenario import Scenario


class CudaBatch(SceneBatch):
    """One ManiSkill task that holds all scenes on a GPU. Images are still made on the CPU."""

    def __init__(self, num_envs: int, spec: SceneSpec, *seen: Any) -> None:
        warn_experimental("PushEnv")
        self._task = PushTask(spec, num_envs, "physx_cuda")
        scenes: Any = iter([_Scene(self._task, i) for i in range(num_envs)])
        super().__init__(num_envs, lambda _: next(scenes), spec, *seen)

    def start(self, indices: Sequence[int], scenarios: Sequence[Scenario]) -> None:
        rows = torch.as_tensor(indices, device=self._task.device)
        self._task.reset(options={"env_idx": rows, "scenarios": list(scenarios)})
        for i in indices:
            placed = self._task.scenarios[i]  # with the lengths of the pool's obstacles
            self._begin_episode(i, placed, placed.tool_pose)

    def step(self, action: Tensor) -> None:
        self._task.step(action.float())

    def measure(self) -> Measurement:
        task = self._task
        names = [task.scenarios[i].pushed_object for i in range(self.num_envs)]
        return Measurement(
            object_pose=planar_poses(task.objects.transforms(names).double().cpu().numpy()),
            ee_pose=planar_poses(
                task.agent.robot.links_map["tip"].pose.raw_pose.double().cpu().numpy()
            ),
            joint_position=task.agent.robot.get_qpos().double().cpu().numpy(),
            contacts=task.contacts.flags().cpu().numpy(),
            target_reachable=task.agent.controller.reachable.cpu().numpy(),
        )

    def get_state(self, index: int) -> SceneState:
        task = self._task
        controller = task.agent.controller
        x, y, yaw = controller.target[index].tolist()
        physics = {k: v for k, v in task.get_state_dict().items() if k != "controller"}
        return SceneState(
            scenario=task.scenarios[index],
            physics=_select_scene(physics, index),
            target=(x, y, yaw),
            contacts=tuple(task.contacts.flags()[index].tolist()),
            target_reachable=bool(controller.reachable[index]),
        )

    def check_state(self, index: int, state: SceneState) -> None:
        """Nothing: what a state must be on CUDA is not known before it has run."""

    def set_state(self, index: int, state: SceneState) -> None:
        """See `SceneBatch`. Contacts are those of the simulation, not of the state."""
        self.start([index], [state.scenario])
        task, controller = self._task, self._task.agent.controller
        physics = _to_device(state.physics, task.device)
        task.set_state_dict(physics, torch.tensor([index], device=task.device))
        controller.target[index] = controller.target.new_tensor(state.target)
        controller.reachable[index] = state.target_reachable

    def close(self) -> None:
        self._task.close()
        super().close()


class _Scene:
    """Poses of the bodies of one of a task's scenes, in the form of an `Engine`."""

    name, version = "sapien", sapien.__version__

    def __init__(self, task: PushTask, index: int) -> None:
        self._task, self._index = task, index

    def object_transform(self) -> list[float]:
        actor = self._task.objects.actors[self._task.scenarios[self._index].pushed_object]
        return actor.pose.raw_pose[self._index].tolist()

    def joint_position(self) -> np.ndarray:
        return self._task.agent.robot.get_qpos()[self._index].cpu().numpy()

    def obstacle_transforms(self) -> np.ndarray:
        return self._task.obstacles.transforms(self._index)

    def link_transforms(self, names: Sequence[str]) -> list[list[float]]:
        links = self._task.agent.robot.links_map
        return [links[name].pose.raw_pose[self._index].tolist() for name in names]

    def picture(self) -> np.ndarray | None:
        if not self._task.scene.can_render():
            return None
        return self._task.render_rgb_array()[self._index].cpu().numpy()

    def close(self) -> None:
        """Nothing: the task is closed once for all scenes."""


def _select_scene(state: Any, index: int) -> Any:
    """One scene's rows of a nested dictionary of tensors, copied."""
    if isinstance(state, dict):
        return {key: _select_scene(value, index) for key, value in state.items()}
    return state[index : index + 1].clone()


def _to_device(state: Any, device: torch.device) -> Any:
    """A nested dictionary of tensors or arrays as tensors on a device."""
    if isinstance(state, dict):
        return {key: _to_device(value, device) for key, value in state.items()}
    return torch.as_tensor(state, device=device)
