"""The ManiSkill task `ClutterPush-v1`: a UR5 pushes an object through clutter to a goal."""

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
import torch
from mani_skill.agents.registration import REGISTERED_AGENTS, register_agent
from mani_skill.envs.sapien_env import BaseEnv
from mani_skill.sensors.camera import CameraConfig
from mani_skill.utils.registration import TimeLimitWrapper, register
from torch import Tensor

from modpush.envs.engines.base import CONTACT_KEYS, SceneSpec, contact_looks
from modpush.envs.engines.sapien.agent import PushArm, agent_class, tip_yaw
from modpush.envs.engines.sapien.builders import camera_from_above
from modpush.envs.engines.sapien.obstacle_bodies import ObstacleSwapper
from modpush.envs.engines.sapien.task import PushTask
from modpush.envs.outcome import GOAL_THRESHOLD, is_at_goal, is_out_of_bounds
from modpush.envs.push_state import make_generators
from modpush.envs.robot.control import start_joints
from modpush.envs.robot.named import ROBOTS, TOOLS
from modpush.envs.scenes.arm_room import check_arm_is_free
from modpush.envs.scenes.objects import get_object_of
from modpush.envs.scenes.sampling import sample_scenario
from modpush.envs.scenes.scenario import Scenario, ScenarioConfig
from modpush.envs.set_fields import set_fields
from modpush.geometry.workspace import BOUNDS_MARGIN


class ClutterPushEnv(PushTask):
    """Push an object to a goal position with a closed gripper, past obstacles.

    Reward modes: `sparse` (1 on reaching the goal) and `none`. Observation modes: ManiSkill's.
    Success terminates; leaving the workspace is reported as `info["out_of_bounds"]` and truncates
    under `gym.make` (`EpisodeEnd`).

    Args:
        num_envs: Number of scenes; more than one needs CUDA.
        scenario: Settings from which episodes are drawn; or give its fields one by one as keywords
            (`scene="slot"`, `pushed_object="fragment"`, ...).
        robot_uids: Arm and tool, `ur5_2f85` or `ur10_rod` for instance; or what `agent_class` makes.
        dynamic_obstacles: Make obstacles movable, 0.5 kg each.
        sim_freq: Physics steps per second.
        control_freq: Actions per second.
        goal_threshold: Largest distance from the object's centre to the goal that is a success [m].
        bounds_margin: Distance outside the workspace at which the object is out of bounds [m].
        obs_mode: ManiSkill's observation mode.
        render_mode: ManiSkill's render mode, or None; a command line can give "none".
        **kwargs: Further arguments of ManiSkill's `BaseEnv`: `control_mode`, `sim_backend`, ...

    Raises:
        ValueError: For unknown scenes or objects (the message lists the known ones), for two objects
            of one name; for several scenes without CUDA.
        RuntimeError: If pictures are asked for and there is no renderer.
    """

    SUPPORTED_REWARD_MODES = ("sparse", "none")
    metadata: ClassVar = {"render_modes": (*BaseEnv.SUPPORTED_RENDER_MODES, "none")}

    def __init__(
        self,
        num_envs: int = 1,
        *,
        scenario: ScenarioConfig | None = None,
        robot_uids: str | type[PushArm] = "ur5_2f85",
        dynamic_obstacles: bool = False,
        sim_freq: int = 120,
        control_freq: int = 15,
        goal_threshold: float = GOAL_THRESHOLD,
        bounds_margin: float = BOUNDS_MARGIN,
        obs_mode: str | None = None,
        render_mode: str | None = None,
        **kwargs: Any,
    ) -> None:
        arm = _find_arm(robot_uids)
        if sim_freq % control_freq:
            raise ValueError(
                "ClutterPushEnv: sim_freq must be a multiple of control_freq, "
                f"got {sim_freq} and {control_freq}."
            )
        fields = {k: kwargs.pop(k) for k in list(kwargs) if k in ScenarioConfig.__annotations__}
        (self.scenario_config,) = set_fields("ClutterPushEnv", fields, scenario or ScenarioConfig())
        self.goal_threshold, self.bounds_margin = goal_threshold, bounds_margin
        self._rngs: list[np.random.Generator] = []
        render_mode = None if render_mode == "none" else render_mode
        images = obs_mode not in (None, "none", "state", "state_dict")
        spec = SceneSpec(
            robot=arm.arm,
            tool=arm.tool,
            objects=self.scenario_config.objects,
            sim_freq=sim_freq,
            control_freq=control_freq,
            dynamic_obstacles=dynamic_obstacles,
            rendered=images or render_mode is not None,
        )
        kwargs |= {"robot_uids": robot_uids, "obs_mode": obs_mode, "render_mode": render_mode}
        super().__init__(spec, num_envs, **kwargs)

    @property
    def _default_sensor_configs(self) -> list[CameraConfig]:
        return [camera_from_above()]

    def reset(
        self, seed: int | Sequence[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start new episodes.

        Args:
            seed: One for the first scene, or one per scene. It determines the whole episode.
            options: ManiSkill's, and `scenarios`, from which episodes start instead of drawing
                them: one `Scenario` for each scene that is reset.
        """
        if "scenario" in (options or {}):
            raise ValueError(
                "ClutterPushEnv.reset: options must have 'scenarios', a sequence of one Scenario for "
                "each scene being reset, got 'scenario'."
            )
        if seed is not None or not self._rngs:
            self._rngs = make_generators(seed, self.num_envs)
        return super().reset(seed=seed, options=options)

    def _initialize_episode(self, env_idx: Tensor, options: dict[str, Any]) -> None:
        arm, tool = self.scene_spec.robot, self.scene_spec.tool
        scenarios = options.get("scenarios")
        if scenarios is None:
            rngs, config = [self._rngs[i] for i in env_idx.tolist()], self.scenario_config
            scenarios = [sample_scenario(rng, config, tool=tool, robot=arm) for rng in rngs]
        self._check_scenarios(scenarios, len(env_idx))
        if self.engine is None:
            super()._initialize_episode(env_idx, {"scenarios": scenarios})
        else:
            (scenario,) = scenarios
            height = self.objects.item(scenario.pushed_object).tool_height
            self.engine.load(scenario, start_joints(arm, tool, scenario.tool_pose, height))
            self.scenarios = [scenario]

    def _check_scenarios(self, scenarios: Any, count: int) -> None:
        given = list(scenarios) if isinstance(scenarios, Sequence) else []
        if len(given) != count or not all(isinstance(one, Scenario) for one in given):
            raise ValueError(
                "ClutterPushEnv.reset: scenarios must be a sequence of one Scenario for each of the "
                f"{count} scenes being reset, got {scenarios!r}."
            )
        for scenario in scenarios:
            height = get_object_of(self.scene_spec.objects, scenario.pushed_object).tool_height
            who = "ClutterPushEnv.reset: scenarios"
            check_arm_is_free(who, scenario, height, self.scene_spec.tool, self.scene_spec.robot)
            if any(obstacle.motion is not None for obstacle in scenario.obstacles):
                raise ValueError(
                    "ClutterPushEnv.reset: obstacles must have motion=None here and on CUDA, got one "
                    "that moves by itself; PushEnv on a CPU has such obstacles."
                )

    def _before_control_step(self) -> None:
        self._substep = 0
        if self.engine is not None:
            self.contacts.clear()

    def _after_simulation_step(self) -> None:
        self._substep += 1
        if self.engine is not None and self._substep in contact_looks(self._sim_steps_per_control):
            self.contacts.read()

    def step(self, action: Any) -> Any:
        """Take ManiSkill's step, after refusing actions that are not finite."""
        values = action.get("action") if isinstance(action, dict) else action
        if values is not None and not torch.isfinite(torch.as_tensor(values)).all():
            raise ValueError(f"ClutterPushEnv.step: action must be finite, got {action}.")
        return super().step(action)

    def evaluate(self) -> dict[str, Tensor]:
        """Success, out of bounds and the contacts, each `[num_envs]` bool."""
        position = self.object_pose[:, :2].cpu().numpy()
        goal = np.array([scenario.goal_position for scenario in self.scenarios])
        bounds = self.scenario_config.bounds(self.bounds_margin)
        found = {
            "success": is_at_goal(position, goal, self.goal_threshold),
            "out_of_bounds": is_out_of_bounds(position, bounds),
        }
        return {
            **{key: torch.from_numpy(value).to(self.device) for key, value in found.items()},
            **dict(zip(CONTACT_KEYS, self.contacts.flags().unbind(-1), strict=True)),
        }

    def _get_obs_extra(self, info: dict[str, Any]) -> dict[str, Tensor]:
        goal = torch.tensor([s.goal_position for s in self.scenarios], device=self.device)
        seen = {"goal_position": goal, "ee_pose": self.ee_pose.float()}
        if not self.obs_mode_struct.use_state:  # images must show the rest, as in ManiSkill's tasks
            return seen
        return {
            "object_pose": self.object_pose.float(),
            **seen,
            **{key: info[key].float()[:, None] for key in CONTACT_KEYS[:3]},
        }

    @property
    def object_transform(self) -> Tensor:
        """Position and quaternion (w, x, y, z) of the pushed body, `[num_envs, 7]` [m]."""
        return self.objects.transforms([s.pushed_object for s in self.scenarios])

    @property
    def object_pose(self) -> Tensor:
        """x, y, yaw of the pushed body, `[num_envs, 3]` float64 [m, m, rad]."""
        return _planar_pose(self.object_transform)

    @property
    def ee_pose(self) -> Tensor:
        """x, y, yaw of the tool's tip, `[num_envs, 3]` float64 [m, m, rad]."""
        return _planar_pose(self.agent.robot.links_map["tip"].pose.raw_pose)

    def get_state_dict(self) -> dict[str, Any]:
        """ManiSkill's state of bodies and controller, movable obstacles among the actors."""
        state = super().get_state_dict()
        if isinstance(self.obstacles, ObstacleSwapper):  # its bodies are not ManiSkill's actors
            state["actors"] = {**state["actors"], **self.obstacles.get_states()}
        return state

    def set_state(self, state: Tensor | np.ndarray, env_idx: Tensor | None = None) -> None:
        """Put bodies into a state of `get_state`, of an episode with as many movable obstacles."""
        # By ManiSkill it says which actors the vector is of, and these change with the layout.
        self._init_raw_state = self.get_state_dict()
        super().set_state(state, env_idx)

    def set_state_dict(self, state: dict[str, Any], env_idx: Tensor | None = None) -> None:
        """Put bodies and controller into a state of `get_state_dict`.

        The state does not hold the layout: to go back to another episode, first
        `reset(options={"scenarios": ...})` with the `scenarios` of that episode.

        Raises:
            ValueError: If the state has other movable obstacles than the present layout.
        """
        if isinstance(self.obstacles, ObstacleSwapper) and "actors" in state:
            names = self.obstacles.get_states().keys()
            given = {n: s for n, s in state["actors"].items() if n.startswith("scene-0_obstacle_")}
            if given.keys() != names:
                raise ValueError(
                    f"ClutterPushEnv.set_state_dict: state must have the movable obstacles "
                    f"{sorted(names)} of the present layout, got {sorted(given)}."
                )
            self.obstacles.set_states(given)
            others = {n: s for n, s in state["actors"].items() if n not in given}
            state = {**state, "actors": others}
        super().set_state_dict(state, env_idx)
        if "controller" in state:
            self.agent.controller.set_state(state["controller"])


def _planar_pose(transform: Tensor) -> Tensor:
    """x, y, yaw of transforms `[B, 7]`, `[B, 3]` float64."""
    transform = transform.double()
    return torch.cat([transform[:, :2], tip_yaw(transform[:, 3:])[:, None]], -1)


def _find_arm(robot_uids: Any) -> type[PushArm]:
    """The class of a registered arm, or the given one."""
    if isinstance(robot_uids, type) and issubclass(robot_uids, PushArm):
        return robot_uids
    known = [f"{arm}_{tool}" for arm in ROBOTS for tool in TOOLS]
    if robot_uids not in known:
        raise ValueError(
            f"ClutterPushEnv: robot_uids must be one of {known} or made by agent_class, "
            f"got {robot_uids!r}."
        )
    return REGISTERED_AGENTS[robot_uids].agent_cls


class EpisodeEnd(TimeLimitWrapper):
    """ManiSkill's time limit, and truncation when the object leaves the workspace."""

    def step(self, action: Any) -> Any:
        """As `gymnasium.Env.step`, batched."""
        observation, reward, terminated, truncated, info = super().step(action)
        return observation, reward, terminated, truncated | info["out_of_bounds"], info


for _arm in ROBOTS.values():
    for _tool in TOOLS.values():
        register_agent()(agent_class(_arm, _tool))
register("ClutterPush-v1", ClutterPushEnv, max_episode_steps=200)
