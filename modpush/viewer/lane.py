"""One policy in one scene, and snapshots of it."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import NestedKey, TensorDictBase
from torchrl.envs import EnvBase, set_exploration_type
from torchrl.envs.utils import ExplorationType, step_mdp

from modpush.encoders.base import as_floats
from modpush.encoders.encode import Encode
from modpush.encoders.vae.model import DepthVAE
from modpush.envs.push_env import PushEnv
from modpush.envs.robot.robot import Robot, Tool
from modpush.envs.scenes.scenario import Scenario
from modpush.evaluation.episodes import Policy
from modpush.viewer.config import CONTROL_FREQ

FLAGS = ("object_contact", "obstacle_contact", "tool_obstacle_contact", "success", "out_of_bounds")
"""Flags of a snapshot, by the keys of `PushEnv`."""


@dataclass(frozen=True, kw_only=True)
class Snapshot:
    """Contents of the picture of one moment. Base frame, metres and radians."""

    scenario: Scenario
    """Obstacles, object and goal."""
    object_pose: tuple[float, float, float]
    """x, y, yaw of the pushed object."""
    ee_pose: tuple[float, float, float]
    """x, y, yaw of the tool's tip."""
    joint_position: NDArray[np.float64]
    """Angles of the arm's joints, `[n]`."""
    robot: Robot
    """The arm."""
    tool: Tool
    """Its tool."""
    step: int
    """Number of control steps since the episode began or the scene was changed."""
    flags: Mapping[str, bool]
    """The keys of `FLAGS`."""
    ended: bool = False
    """True once the episode is over."""
    path: NDArray[np.float64] | None = None
    """The planned path that the policy follows, `[n, 2]`."""
    subgoal: tuple[float, float] | None = None
    """The sub-goal that the policy acts upon."""
    occupancy: NDArray[np.bool_] | None = None
    """The inflated map on the camera's grid, `[H, W]`."""
    window: NDArray[np.float32] | None = None
    """The local window, `[S, S]` in [0, 1]."""

    @property
    def present(self) -> Scenario:
        """The scenario with the obstacles that move by themselves where they are now."""
        if all(obstacle.motion is None for obstacle in self.scenario.obstacles):
            return self.scenario
        now = (obstacle.after(self.step / CONTROL_FREQ) for obstacle in self.scenario.obstacles)
        return replace(self.scenario, obstacles=tuple(now))


class Lane(Protocol):
    """Running policy or stored episode that a `Session` shows."""

    name: str
    """Name for the page."""

    def start(self, scenario: Scenario, number: int) -> Snapshot:
        """Start an episode; `number` is that of a stored one."""

    def step(self) -> Snapshot:
        """Take one control step."""

    def reconstruction(self) -> NDArray[np.float32] | None:
        """The autoencoder's reconstruction of the window, `[S, S]` in [0, 1], if there is one."""

    def close(self) -> None:
        """Free what it holds."""


class PolicyLane:
    """A policy in an environment of one scene.

    Args:
        name: Name for the page.
        env: A `PushEnv` with transforms, batch size `[1]`. Path, sub-goal, map and window are shown
            where it emits them.
        policy: Acts on what `env` emits.
        path_key: Key of the planned path in the result of `env.step`, `[1, n, 2]` [m].
        target_key: The same of the sub-goal, `[1, 2]` [m].
    """

    def __init__(
        self,
        name: str,
        env: EnvBase,
        policy: Policy,
        *,
        path_key: NestedKey = "path",
        target_key: NestedKey = "subgoal",
    ) -> None:
        self.name, self.env, self.policy = name, env, policy
        self._path_key, self._target_key = path_key, target_key
        self._vae = _autoencoder(env)
        self._step = 0
        simulator: PushEnv = getattr(env, "base_env", env)
        self._robot, self._tool = simulator.robot, simulator.tool

    def start(self, scenario: Scenario, number: int = 0) -> Snapshot:
        """Start an episode."""
        self._td = self.env.reset(scenarios=[scenario])
        self._scenario, self._step = scenario, 0
        return self._snapshot(self._td, self._td)

    @torch.no_grad()
    def step(self) -> Snapshot:
        """Take one control step."""
        with set_exploration_type(ExplorationType.DETERMINISTIC):
            chosen = self.policy(self._td)
        td = self.env.step(chosen)
        self._td = step_mdp(td)
        self._step += 1
        return self._snapshot(self._td, td)

    def _snapshot(self, now: TensorDictBase, plan: TensorDictBase) -> Snapshot:
        """Snapshot of the state now, with the path and sub-goal that led here."""
        x, y, yaw = now["object_pose"][0].tolist()
        tool_x, tool_y, tool_yaw = now["ee_pose"][0].tolist()
        path, target = plan.get(self._path_key, None), plan.get(self._target_key, None)
        occupancy, window = now.get("occupancy", None), now.get("window", None)
        return Snapshot(
            scenario=self._scenario,
            object_pose=(x, y, yaw),
            ee_pose=(tool_x, tool_y, tool_yaw),
            joint_position=now["joint_position"][0].double().numpy(),
            robot=self._robot,
            tool=self._tool,
            step=self._step,
            flags={key: bool(now[key].item()) for key in FLAGS},
            ended=bool(now["done"].item()),
            path=None if path is None else path[0].double().numpy(),
            subgoal=None if target is None else (float(target[0, 0]), float(target[0, 1])),
            occupancy=None if occupancy is None else occupancy[0, 0].numpy(),
            window=None if window is None else as_floats(window[0, 0]).numpy(),
        )

    @torch.no_grad()
    def reconstruction(self) -> NDArray[np.float32] | None:
        """The autoencoder's reconstruction of the window; None with another encoder."""
        if self._vae is None or "window" not in self._td.keys():
            return None
        return self._vae.reconstruct(self._td["window"])[0, 0].numpy()

    def close(self) -> None:
        """Close the environment."""
        self.env.close(raise_if_closed=False)


def _autoencoder(env: EnvBase) -> DepthVAE | None:
    """The autoencoder that encodes the window, if it is one."""
    for transform in getattr(env, "transform", ()):
        if isinstance(transform, Encode) and isinstance(transform.encoder, DepthVAE):
            return transform.encoder
    return None
