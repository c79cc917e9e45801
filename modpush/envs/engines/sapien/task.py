"""The ManiSkill task `ClutterPush-v1`: a UR5 pushes an object through clutter to a goal.

On a CPU one task holds one scene, which is made anew at every reset. On CUDA one task holds all
scenes, and obstacles come from a pool, since bodies cannot be added to a running GPU simulation.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
import sapien
import torch
from mani_skill.agents.registration import REGISTERED_AGENTS
from mani_skill.envs.sapien_env import BaseEnv
from mani_skill.sensors.camera import CameraConfig
from mani_skill.utils.registration import TimeLimitWrapper, register
from mani_skill.utils.structs import Pose
from mani_skill.utils.structs.types import SimConfig
from torch import Tensor

from modpush.envs.arguments import check_simulation
from modpush.envs.engines.base import CONTACT_KEYS, SceneSpec, contact_looks
from modpush.envs.engines.sapien.agent import PushArm, agent_class, tip_yaw
from modpush.envs.engines.sapien.builders import (
    build_goal_marker,
    build_table,
    camera_from_above,
    camera_from_the_side,
    make_material,
    set_material,
    simulation_config,
)
from modpush.envs.engines.sapien.contacts import CpuContacts
from modpush.envs.engines.sapien.cuda_obstacles import CudaContacts, ObstaclePool
from modpush.envs.engines.sapien.engine import SapienEngine
from modpush.envs.engines.sapien.object_bodies import ObjectBodies
from modpush.envs.engines.sapien.obstacle_bodies import ObstacleSwapper
from modpush.envs.engines.sapien.rendering import choose_render_backend
from modpush.envs.outcome import GOAL_THRESHOLD, is_at_goal, is_out_of_bounds
from modpush.envs.push_state import make_generators
from modpush.envs.robot.control import start_joints
from modpush.envs.robot.named import ROBOTS, TOOLS
from modpush.envs.scenes.arm_room import check_arm_is_free
from modpush.envs.scenes.objects import get_object_of
from modpush.envs.scenes.sampling import sample_scenario
from modpush.envs.scenes.scenario import Scenario, ScenarioConfig
from modpush.envs.simulation_config import set_fields
from modpush.geometry.workspace import BOUNDS_MARGIN


class ClutterPushEnv(BaseEnv):
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
        **kwargs: Arguments of ManiSkill's `BaseEnv`: `obs_mode`, `render_mode`, `sim_backend`, ...

    Raises:
        ValueError: For unknown scenes or objects (the message lists the known ones), for two objects
            of one name; for several scenes without CUDA.
        RuntimeError: If pictures are asked for and there is no renderer.
    """

    SUPPORTED_ROBOTS = None  # of any class of `agent_class`, which ManiSkill would warn of
    SUPPORTED_REWARD_MODES = ("sparse", "none")
    agent: PushArm

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
        render_backend: str = "auto",
        **kwargs: Any,
    ) -> None:
        _check_arm(robot_uids)
        check_simulation(num_envs, kwargs.get("sim_backend", "auto"), sim_freq, control_freq)
        fields = {k: kwargs.pop(k) for k in list(kwargs) if k in ScenarioConfig.__annotations__}
        (self.scenario_config,) = set_fields("ClutterPushEnv", fields, scenario or ScenarioConfig())
        self.pushed_objects = self.scenario_config.objects
        self.dynamic_obstacles = dynamic_obstacles
        self.goal_threshold, self.bounds_margin = goal_threshold, bounds_margin
        self.scenarios: list[Scenario] = []
        self._frequencies = (sim_freq, control_freq)
        self._rngs: list[np.random.Generator] = []
        if kwargs.get("render_mode") == "none":  # as a command line gives it, ManiSkill's for one
            kwargs["render_mode"] = None
        if render_backend == "auto":
            drawn = kwargs.get("obs_mode") not in (None, "none", "state", "state_dict")
            pictures = drawn or kwargs.get("render_mode") is not None
            render_backend = choose_render_backend() if pictures else "none"
        self._render_name = render_backend
        if render_backend.startswith("pci"):
            render_backend = "cpu"  # `_setup_scene` puts the real one in its place
        super().__init__(
            num_envs=num_envs, robot_uids=robot_uids, render_backend=render_backend, **kwargs
        )

    @classmethod
    def of_spec(cls, spec: SceneSpec, **options: Any) -> "ClutterPushEnv":
        """The task that has the scenes of a specification.

        Args:
            spec: The properties of every scene.
            **options: Further arguments.

        Raises:
            RuntimeError: If a renderer is needed and there is none.
        """
        return cls(
            obs_mode="none",
            scenario=ScenarioConfig(pushed_object=spec.objects),
            robot_uids=agent_class(spec.robot, spec.tool),
            dynamic_obstacles=spec.dynamic_obstacles,
            sim_freq=spec.sim_freq,
            control_freq=spec.control_freq,
            render_backend=choose_render_backend() if spec.rendered else "none",
            **options,
        )

    @property
    def _default_sim_config(self) -> SimConfig:
        return simulation_config(*self._frequencies)

    @property
    def _default_sensor_configs(self) -> list[CameraConfig]:
        return [camera_from_above()]

    @property
    def _default_human_render_camera_configs(self) -> CameraConfig:
        return camera_from_the_side()

    def _setup_scene(self) -> None:
        # ManiSkill splits "pci:0" at its colon and fails, so the device is put in here.
        if self._render_name.startswith("pci"):
            self.backend.render_device = sapien.Device(self._render_name)
            self._render_device = self.backend.render_device
        super()._setup_scene()

    def _clear(self) -> None:
        # ManiSkill's own collects garbage, which takes 0.3 s beside all that it and torch import. A task
        # that has no scene yet has nothing to free.
        if self.scene is not None:
            super()._clear()
        self._hidden_objects: list[Any] = []

    def _load_agent(self, options: dict[str, Any], *args: Any, **kwargs: Any) -> None:
        found = self.robot_uids
        arm = REGISTERED_AGENTS[found].agent_cls if isinstance(found, str) else found
        pose = Pose.create_from_pq(torch.tensor([arm.arm.base]))
        super()._load_agent(options, pose, *args, **kwargs)

    def _load_scene(self, options: dict[str, Any]) -> None:
        scene, robot = self.scene, self.agent.robot
        build_table(scene, robot.links_map[self.agent.arm.links[0].name], make_material("table"))
        set_material(robot, make_material("tool"))
        self.objects = ObjectBodies(scene, self.pushed_objects, make_material("object"))
        self.marker = build_goal_marker(scene, self.goal_threshold) if scene.can_render() else None
        """Disc at the goal, where there is a renderer."""
        if self.marker is not None:
            self._hidden_objects.append(self.marker)
        actors = list(self.objects.actors.values())
        self.obstacles: Any
        self.contacts: Any
        self.engine: SapienEngine | None = None
        """Places and steps the one scene of a CPU task."""
        material, dynamic = make_material("obstacle"), self.dynamic_obstacles
        if self.gpu_sim_enabled:
            pool = self.obstacles = ObstaclePool(scene, material, dynamic)
            self.contacts = CudaContacts(scene, robot, actors, pool.actors)
        else:
            swapper = self.obstacles = ObstacleSwapper(scene, material, dynamic)
            self.contacts = CpuContacts(scene, robot, actors, swapper)
            self.engine = SapienEngine(self)

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
        indices = env_idx.tolist()
        scenarios = options.get("scenarios")
        if scenarios is None:
            arm, tool = self.agent.arm, self.agent.tool
            scenarios = [
                sample_scenario(self._rngs[i], self.scenario_config, tool=tool, robot=arm)
                for i in indices
            ]
        if (
            not isinstance(scenarios, Sequence)
            or len(scenarios) != len(indices)
            or not all(isinstance(scenario, Scenario) for scenario in scenarios)
        ):
            raise ValueError(
                "ClutterPushEnv.reset: scenarios must be a sequence of one Scenario for each of the "
                f"{len(indices)} scenes being reset, got {scenarios!r}."
            )
        for scenario in scenarios:
            item = get_object_of(self.pushed_objects, scenario.pushed_object)
            check_arm_is_free(
                "ClutterPushEnv.reset: scenarios",
                scenario,
                item.tool_height,
                self.agent.tool,
                self.agent.arm,
            )
            if any(obstacle.motion is not None for obstacle in scenario.obstacles):
                raise ValueError(
                    "ClutterPushEnv.reset: obstacles must have motion=None here and on CUDA, got one "
                    "that moves by itself; PushEnv on a CPU has such obstacles."
                )
        joints = [] if self.engine is None else [self._start_joints(s) for s in scenarios]
        if not self.scenarios:
            self.scenarios = list(scenarios)
            self._goal = torch.zeros(self.num_envs, 2, dtype=torch.float64, device=self.device)
        for i, scenario in zip(indices, scenarios, strict=True):
            self.scenarios[i] = scenario
            self._goal[i] = self._goal.new_tensor(scenario.goal_position)
        if self.engine is not None:
            self.engine.load(scenarios[0], joints[0])
        else:
            self._place_on_cuda(env_idx, scenarios)

    def _start_joints(self, scenario: Scenario) -> np.ndarray:
        height = self.objects.item(scenario.pushed_object).tool_height
        return start_joints(self.agent.arm, self.agent.tool, scenario.tool_pose, height)

    def _place_on_cuda(self, env_idx: Tensor, scenarios: Sequence[Scenario]) -> None:
        """Move the bodies of a running GPU simulation, to which none can be added."""
        placed = self.obstacles.place(env_idx.tolist(), [s.obstacles for s in scenarios])
        for i, scenario, obstacles in zip(env_idx.tolist(), scenarios, placed, strict=True):
            self.scenarios[i] = replace(scenario, obstacles=obstacles)
        if self.marker is not None:
            goal = torch.nn.functional.pad(self._goal[env_idx].float(), (0, 1), value=0.0005)
            self.marker.set_pose(Pose.create_from_pq(goal))
        self.objects.place(scenarios)
        tip_height = [self.objects.item(s.pushed_object).tool_height for s in scenarios]
        self.agent.place_tip([s.tool_pose for s in scenarios], tip_height)

    def _before_control_step(self) -> None:
        self._substep = 0
        if self.engine is not None:
            self.contacts.clear()

    def _after_simulation_step(self) -> None:
        self._substep += 1
        if self.engine is not None and self._substep in contact_looks(self._sim_steps_per_control):
            self.contacts.read()

    def contact_flags(self) -> Tensor:
        """The contacts of the last step, `[num_envs, 6]` bool, in the order of `CONTACT_KEYS`."""
        return self.contacts.flags()

    def step(self, action: Any) -> Any:
        """Take ManiSkill's step, after refusing actions that are not finite."""
        values = action.get("action") if isinstance(action, dict) else action
        if values is not None and not torch.isfinite(torch.as_tensor(values)).all():
            raise ValueError(f"ClutterPushEnv.step: action must be finite, got {action}.")
        return super().step(action)

    def evaluate(self) -> dict[str, Tensor]:
        """Success, out of bounds and the contacts, each `[num_envs]` bool."""
        position = self.object_pose[:, :2]
        bounds = self.scenario_config.bounds(self.bounds_margin)
        return {
            "success": is_at_goal(position, self._goal, self.goal_threshold),
            "out_of_bounds": is_out_of_bounds(position, bounds),
            **dict(zip(CONTACT_KEYS, self.contacts.flags().unbind(-1), strict=True)),
        }

    def _get_obs_extra(self, info: dict[str, Any]) -> dict[str, Tensor]:
        seen = {"goal_position": self._goal.float(), "ee_pose": self.ee_pose.float()}
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
        transform = self.object_transform.double()
        return torch.cat([transform[:, :2], tip_yaw(transform[:, 3:])[:, None]], -1)

    @property
    def ee_pose(self) -> Tensor:
        """x, y, yaw of the tool's tip, `[num_envs, 3]` float64 [m, m, rad]."""
        pose = self.agent.robot.links_map["tip"].pose
        return torch.cat([pose.p[:, :2].double(), tip_yaw(pose.q.double())[:, None]], -1)

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


def _check_arm(robot_uids: Any) -> None:
    """Refuse what is no arm of `agent_class`."""
    known = [f"{arm}_{tool}" for arm in ROBOTS for tool in TOOLS]
    own = isinstance(robot_uids, type) and issubclass(robot_uids, PushArm)
    if not (own or robot_uids in known):
        raise ValueError(
            f"ClutterPushEnv: robot_uids must be one of {known} or made by agent_class, "
            f"got {robot_uids!r}."
        )


class EpisodeEnd(TimeLimitWrapper):
    """ManiSkill's time limit, and truncation when the object leaves the workspace."""

    def step(self, action: Any) -> Any:
        """As `gymnasium.Env.step`, batched."""
        observation, reward, terminated, truncated, info = super().step(action)
        return observation, reward, terminated, truncated | info["out_of_bounds"], info


register("ClutterPush-v1", ClutterPushEnv, max_episode_steps=200)
