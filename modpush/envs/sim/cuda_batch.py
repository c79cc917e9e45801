"""Scenes in one batched simulation on CUDA. Experimental: it has never been run."""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from modpush._experimental import warn_experimental
from modpush.envs.depth.base import DepthCameraFactory
from modpush.envs.scenes.scenario import Scenario
from modpush.envs.sim.batch import Measurement, SceneBatch
from modpush.envs.sim.scene_state import SceneState
from modpush.envs.sim.task import ClutterPushEnv

__all__ = ["CudaBatch"]


class CudaBatch(SceneBatch):
    """One task that holds all scenes on a GPU. Images are still made on the CPU.

    Args:
        num_envs: Number of scenes.
        depth: What makes the depth camera of a task, or None.
        arm_in_depth: Whether the depth camera sees the arm.
        **task: Arguments of `ClutterPushEnv`.

    Raises:
        ValueError: If there is no CUDA device.
    """

    def __init__(
        self, num_envs: int, depth: DepthCameraFactory | None, arm_in_depth: bool, **task: Any
    ) -> None:
        warn_experimental("PushEnv")
        self._task = ClutterPushEnv(
            obs_mode="none", num_envs=num_envs, sim_backend="physx_cuda", **task
        )
        super().__init__([self._task], depth, arm_in_depth)

    def start(self, indices: Sequence[int], scenarios: Sequence[Scenario]) -> None:
        """See `SceneBatch`."""
        rows = torch.as_tensor(indices, device=self._task.device)
        self._task.reset(options={"env_idx": rows, "scenarios": list(scenarios)})
        for i in indices:
            self._begin_episode(i)

    def step(self, action: Tensor) -> None:
        """See `SceneBatch`."""
        self._task.step(action.float())

    def measure(self) -> Measurement:
        """See `SceneBatch`."""
        task = self._task
        tensors = (
            task.object_pose,
            task.ee_pose,
            task.agent.robot.get_qpos().double(),
            task.contacts.flags(),
            task.agent.controller.reachable,
        )
        return Measurement(*(tensor.cpu().numpy() for tensor in tensors))

    def get_state(self, index: int) -> SceneState:
        """See `SceneBatch`."""
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
