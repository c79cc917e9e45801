"""Policies by name, one policy in one scene, and snapshots of it."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase, set_exploration_type
from torchrl.envs.utils import ExplorationType, step_mdp

from modpush.envs.push_env import PushEnv
from modpush.envs.robot.robot import Robot, Tool
from modpush.envs.scenes.objects import OBJECTS
from modpush.envs.scenes.scenario import Scenario
from modpush.evaluation.episodes import Policy
from modpush.viewer.config import CONTROL_FREQ, PlayConfig

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

    @property
    def present(self) -> Scenario:
        """The scenario with the obstacles that move by themselves where they are now."""
        if all(obstacle.motion is None for obstacle in self.scenario.obstacles):
            return self.scenario
        now = (obstacle.after(self.step / CONTROL_FREQ) for obstacle in self.scenario.obstacles)
        return replace(self.scenario, obstacles=tuple(now))


class PolicyLane:
    """A policy in an environment of one scene.

    Args:
        name: Name for the page.
        env: A `PushEnv` with transforms, batch size `[1]`. Path, sub-goal and map are shown where it
            emits them.
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
        self._step = 0
        simulator: PushEnv = getattr(env, "base_env", env)
        self.robot, self.tool = simulator.robot, simulator.tool

    def start(self, scenario: Scenario) -> Snapshot:
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
        occupancy = now.get("occupancy", None)
        return Snapshot(
            scenario=self._scenario,
            object_pose=(x, y, yaw),
            ee_pose=(tool_x, tool_y, tool_yaw),
            joint_position=now["joint_position"][0].double().numpy(),
            robot=self.robot,
            tool=self.tool,
            step=self._step,
            flags={key: bool(now[key].item()) for key in FLAGS},
            ended=bool(now["done"].item()),
            path=None if path is None else path[0].double().numpy(),
            subgoal=None if target is None else (float(target[0, 0]), float(target[0, 1])),
            occupancy=None if occupancy is None else occupancy[0, 0].numpy(),
        )

    def close(self) -> None:
        """Close the environment."""
        self.env.close(raise_if_closed=False)


POLICIES = ("agent", "corridor", "corridor_faithful", "scripted", "hand")
"""Names of the policies; `"agent"` is the shipped one for all objects, or that for goal poses. What
`get_method` takes can be given as well."""


def make_lane(policy: str, config: PlayConfig) -> PolicyLane:
    """A policy in an environment of one scene that holds all shipped objects.

    Args:
        policy: `"hand"`, or what `get_method` takes.
        config: Robot, tool, engine, goal, and modules from which an agent's file may import its
            author's own parts.

    Raises:
        ValueError: If there is no such policy, the file is not an agent, or names modules that are not
            allowed.
    """
    # Here, since the simulator comes with it.
    from modpush.recipes.methods import get_method

    known = {"hand": "scripted"}.get(policy, policy)
    if policy == "agent" and config.goal == "pose":
        known = "pose"
    method = get_method(known, allow=config.allow)
    names = ("engine", "robot", "tool")
    options = {name: v for name in names if (v := getattr(config, name)) is not None}
    if config.engine is not None:
        options["sim_freq"] = None  # the engine's own
    if config.goal == "pose":
        options["goal"] = "pose"
    options |= {"max_episode_steps": None, "keep_images": True}
    env = method.make_env(1, tuple(OBJECTS), **options)
    acting = HandPolicy() if policy == "hand" else method.make_policy()
    name = Path(policy).stem
    return PolicyLane(name, env, acting, path_key=method.path_key, target_key=method.target_key)


class HandPolicy(TensorDictModuleBase):
    """Takes the action that was last pressed for some steps, then stands still.

    A browser repeats a key that is held about 30 times a second after a first pause of up to half a
    second; a press therefore lasts a few steps.
    """

    in_keys = ["object_pose"]  # noqa: RUF012
    out_keys = ["action"]  # noqa: RUF012

    def __init__(self) -> None:
        super().__init__()
        self._action = (0.0, 0.0, 0.0)
        self._steps_left = 0

    def press(self, action: tuple[float, float, float], steps: int = 5) -> None:
        """Take an action (dx, dy, dyaw) in [-1, 1], base frame, for this many steps."""
        self._action, self._steps_left = action, steps

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the action, `[B, 3]`."""
        pose = tensordict["object_pose"]
        values = self._action if self._steps_left > 0 else (0.0, 0.0, 0.0)
        self._steps_left -= 1
        tensordict["action"] = torch.tensor(values).expand(pose.shape[0], 3).clone()
        return tensordict
