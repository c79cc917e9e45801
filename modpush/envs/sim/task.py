"""The ManiSkill task `ClutterPush-v1`: a UR5 pushes an object through clutter to a goal.

On a CPU one task holds one scene, whose obstacles are replaced at every reset. On CUDA one task holds
all scenes, and obstacles come from a pool that is built once, since bodies cannot be added to a
running GPU simulation.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
import sapien
import torch
from mani_skill.envs.sapien_env import BaseEnv
from mani_skill.sensors.camera import CameraConfig
from mani_skill.utils.registration import register
from mani_skill.utils.structs import Pose
from mani_skill.utils.structs.types import SceneConfig, SimConfig
from sapien import physx
from torch import Tensor

from modpush.envs.outcome import GOAL_THRESHOLD, is_at_goal, is_out_of_bounds
from modpush.envs.robot.ur5_2f85 import Tool
from modpush.envs.scenes.sampling import sample_scenario
from modpush.envs.scenes.scenario import Scenario, ScenarioConfig
from modpush.envs.sim.agent import UR5, tip_yaw
from modpush.envs.sim.builders import (
    build_goal_marker,
    build_table,
    camera_from_above,
    camera_from_the_side,
)
from modpush.envs.sim.contacts import CONTACT_KEYS, CpuContacts, CudaContacts
from modpush.envs.sim.cpu_scene import CpuScene
from modpush.envs.sim.object_bodies import ObjectBodies
from modpush.envs.sim.obstacle_bodies import ObstaclePool, ObstacleSwapper
from modpush.envs.sim.rendering import choose_render_backend
from modpush.geometry.workspace import BOUNDS_MARGIN

__all__ = ["FRICTION", "MAX_EPISODE_STEPS", "ClutterPushEnv"]

MAX_EPISODE_STEPS = 200
FRICTION: dict[str, float] = {"object": 0.5, "table": 0.5, "obstacle": 0.5, "tool": 0.0}
"""Friction coefficient of each material. PhysX takes the mean of two, so that it is 0.5 between object
and table, 0.25 between tool and object, and 0.5 between object and obstacle."""


class ClutterPushEnv(BaseEnv):
    """Push an object to a goal position with a closed gripper, past obstacles.

    Reward modes: `sparse` (1 on reaching the goal) and `none`. Observation modes: ManiSkill's.
    Success terminates; leaving the workspace is reported as `info["out_of_bounds"]` and truncates
    under `gym.make` (`EpisodeEnd`).

    Args:
        num_envs: Number of scenes; more than one needs CUDA.
        scenario: What episodes are drawn from; or give its fields one by one as keywords
            (`scene="slot"`, `pushed_object="fragment"`, ...).
        robot_uids: `ur5_2f85` or `ur5_rod`.
        dynamic_obstacles: Make obstacles movable, 0.5 kg each.
        sim_freq: Physics steps per second.
        control_freq: Actions per second.
        goal_threshold: Largest distance from the object's centre to the goal that is a success [m].
        bounds_margin: The object is out of bounds when its centre is farther outside the workspace
            than this [m].
        obstacle_pool: Place bodies on a CPU as on CUDA, for tests: obstacles come from a pool,
            unused objects are parked, mass and friction stay as built.
        **kwargs: Arguments of ManiSkill's `BaseEnv`: `obs_mode`, `render_mode`, `sim_backend`, ...

    Raises:
        ValueError: For unknown scenes or objects, with the list of those there are; for two objects
            of one name; for several scenes without CUDA.
        RuntimeError: If pictures are asked for and there is no renderer.
    """

    SUPPORTED_ROBOTS: ClassVar[list[str]] = ["ur5_2f85", "ur5_rod"]
    SUPPORTED_REWARD_MODES = ("sparse", "none")
    agent: UR5

    def __init__(
        self,
        num_envs: int = 1,
        *,
        scenario: ScenarioConfig | None = None,
        robot_uids: str = "ur5_2f85",
        dynamic_obstacles: bool = False,
        sim_freq: int = 120,
        control_freq: int = 15,
        goal_threshold: float = GOAL_THRESHOLD,
        bounds_margin: float = BOUNDS_MARGIN,
        obstacle_pool: bool = False,
        render_backend: str = "auto",
        **kwargs: Any,
    ) -> None:
        _check_backend(num_envs, kwargs.get("sim_backend", "auto"))
        fields = {k: kwargs.pop(k) for k in list(kwargs) if k in ScenarioConfig.__annotations__}
        if scenario is not None and fields:
            raise ValueError(
                f"ClutterPushEnv: give either scenario or its fields, got both: {sorted(fields)}."
            )
        if sim_freq % control_freq:
            raise ValueError(
                f"ClutterPushEnv: sim_freq must be a multiple of control_freq, "
                f"got {sim_freq} and {control_freq}."
            )
        self.scenario_config = scenario or ScenarioConfig(**fields)
        self.pushed_objects = self.scenario_config.objects
        self.dynamic_obstacles = dynamic_obstacles
        self.goal_threshold = goal_threshold
        self.bounds_margin = bounds_margin
        self.scenarios: list[Scenario] = []
        self._frequencies = (sim_freq, control_freq)
        self._want_pool = obstacle_pool
        self._rngs: list[np.random.Generator] = []
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

    @property
    def _default_sim_config(self) -> SimConfig:
        sim_freq, control_freq = self._frequencies
        return SimConfig(
            sim_freq=sim_freq,
            control_freq=control_freq,
            spacing=3,
            # A small contact offset keeps the number of contact pairs small; the fastest body
            # moves 2.5 mm in a physics step.
            # With 8 solver iterations instead of ManiSkill's 15, a squeezed object sank 3.9 mm into
            # an obstacle once in a 10-minute soak.
            scene_config=SceneConfig(contact_offset=0.005, solver_position_iterations=15),
        )

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

    def _load_agent(self, options: dict[str, Any], *args: Any, **kwargs: Any) -> None:
        super()._load_agent(options, Pose.create_from_pq(), *args, **kwargs)

    def _load_scene(self, options: dict[str, Any]) -> None:
        scene, robot = self.scene, self.agent.robot
        table, tool, thing, obstacle = (
            physx.PhysxMaterial(FRICTION[name], FRICTION[name], 0.0)
            for name in ("table", "tool", "object", "obstacle")
        )
        build_table(scene, robot.links_map["base"], table)
        for link in robot.links:
            for raw in link._objs:
                for shape in raw.collision_shapes:
                    shape.physical_material = tool
        self.objects = ObjectBodies(scene, self.pushed_objects, thing)
        pool = self._want_pool or self.gpu_sim_enabled
        self.obstacles = (ObstaclePool if pool else ObstacleSwapper)(
            scene, obstacle, self.dynamic_obstacles
        )
        self._marker = build_goal_marker(scene, self.goal_threshold) if scene.can_render() else None
        if self._marker is not None:
            self._hidden_objects.append(self._marker)
        actors = list(self.objects.actors.values())
        self.contacts: CpuContacts | CudaContacts
        self.cpu_scene: CpuScene | None = None
        if self.gpu_sim_enabled:
            self.contacts = CudaContacts(scene, robot, actors, self.obstacles.actors)
        else:
            self.contacts = CpuContacts(scene, robot, actors, self.obstacles)
            if not pool:
                self.cpu_scene = CpuScene(
                    scene, robot, self.agent.tool.length, self.objects, self.contacts
                )

    def reset(
        self,
        seed: int | Sequence[int] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Any, dict[str, Any]]:
        """Start new episodes.

        Args:
            seed: One for the first scene, or one per scene. It determines the whole episode.
            options: ManiSkill's, and `scenarios`, from which episodes start instead of drawing
                them: one `Scenario` for each scene that is reset.
        """
        if seed is not None:
            seeds = [seed] if isinstance(seed, int | np.integer) else list(seed)
            if len(seeds) != self.num_envs:
                seeds = [seeds[0] + i for i in range(self.num_envs)]
            self._rngs = [np.random.default_rng(s) for s in seeds]
        elif not self._rngs:
            sequences = np.random.SeedSequence().spawn(self.num_envs)
            self._rngs = [np.random.default_rng(s) for s in sequences]
        return super().reset(seed=seed, options=options)

    def _initialize_episode(self, env_idx: Tensor, options: dict[str, Any]) -> None:
        indices = env_idx.tolist()
        scenarios = options.get("scenarios")
        if scenarios is None:
            scenarios = [self.draw_scenario(self._rngs[i]) for i in indices]
        if len(scenarios) != len(indices):
            raise ValueError(
                f"ClutterPushEnv.reset: scenarios must have one entry for each of the "
                f"{len(indices)} scenes being reset, got {len(scenarios)}."
            )
        if not self.scenarios:
            self.scenarios = list(scenarios)
            self._goal = torch.zeros(self.num_envs, 2, dtype=torch.float64, device=self.device)
        for i, scenario in zip(indices, scenarios, strict=True):
            self._goal[i] = self._goal.new_tensor(scenario.goal_position)
        standing = self.obstacles.place(indices, [s.obstacles for s in scenarios])
        for i, scenario, obstacles in zip(indices, scenarios, standing, strict=True):
            self.scenarios[i] = replace(scenario, obstacles=obstacles)
        if self._marker is not None:
            goal = torch.nn.functional.pad(self._goal[env_idx].float(), (0, 1), value=0.0005)
            self._marker.set_pose(Pose.create_from_pq(goal))
        if self.cpu_scene is not None:
            self.cpu_scene.place(scenarios[0])
        else:
            self.objects.place(scenarios)
            tip_height = [self.objects.item(s.pushed_object).tool_height for s in scenarios]
            self.agent.place_tip([s.tool_pose for s in scenarios], tip_height)
        self.contacts.reset(env_idx)

    def draw_scenario(self, rng: np.random.Generator) -> Scenario:
        """An episode's start from this task's configuration."""
        return sample_scenario(rng, self.scenario_config, tool=self.agent.tool_name)

    def _before_control_step(self) -> None:
        self.contacts.clear()
        self._substep = 0

    def _after_simulation_step(self) -> None:
        self._substep += 1
        self.contacts.after_substep(self._substep, self._sim_steps_per_control)

    def step(self, action: Any) -> Any:
        """ManiSkill's step; actions with NaN are refused before anything moves."""
        if action is not None:
            values = torch.as_tensor(action)
            if not torch.isfinite(values).all():
                raise ValueError(f"ClutterPushEnv.step: action must be finite, got {action}.")
        return super().step(action)

    def evaluate(self) -> dict[str, Tensor]:
        """Success, out of bounds and the three contacts, each `[num_envs]` bool."""
        position = self.object_pose[:, :2]
        bounds = self.scenario_config.bounds(self.bounds_margin)
        return {
            "success": is_at_goal(position, self._goal, self.goal_threshold),
            "out_of_bounds": is_out_of_bounds(position, bounds),
            **dict(zip(CONTACT_KEYS, self.contacts.flags().unbind(-1), strict=True)),
        }

    def _get_obs_extra(self, info: dict[str, Any]) -> dict[str, Tensor]:
        return {
            "object_pose": self.object_pose.float(),
            "goal_position": self._goal.float(),
            "ee_pose": self.ee_pose.float(),
            **{key: info[key].float()[:, None] for key in CONTACT_KEYS},
        }

    @property
    def object_transform(self) -> Tensor:
        """Position and quaternion (w, x, y, z) of the pushed body, `[num_envs, 7]` [m]."""
        return self.objects.transforms([s.pushed_object for s in self.scenarios])

    @property
    def object_pose(self) -> Tensor:
        """x, y, yaw of the pushed body, `[num_envs, 3]` float64 [m, m, rad]."""
        transform = self.object_transform.double()
        yaw = tip_yaw(transform[:, 3:])
        return torch.cat([transform[:, :2], yaw[:, None]], -1)

    def object_transform_of(self, index: int) -> np.ndarray:
        """Position and quaternion (w, x, y, z) of the pushed body of one scene, `[7]` [m]."""
        if self.cpu_scene is not None:
            return np.array(self.cpu_scene.object_transform())
        actor = self.objects.actors[self.scenarios[index].pushed_object]
        return np.array(actor.pose.raw_pose[index].tolist())

    def obstacle_transforms_of(self, index: int) -> np.ndarray:
        """The same for the obstacles of one scene, in the order of its layout, `[n, 7]` [m]."""
        return self.obstacles.transforms(index)

    @property
    def tool(self) -> Tool:
        """What the arm holds."""
        return self.agent.tool

    def link_transforms_of(self, index: int, names: Sequence[str]) -> np.ndarray:
        """The same for links of the robot, `[len(names), 7]` [m]."""
        if self.cpu_scene is not None:
            return np.array(self.cpu_scene.link_transforms(names))
        links = self.agent.robot.links_map
        return np.array([links[name].pose.raw_pose[index].tolist() for name in names])

    @property
    def ee_pose(self) -> Tensor:
        """x, y, yaw of the tool's tip, `[num_envs, 3]` float64 [m, m, rad]."""
        pose = self.agent.robot.links_map["tip"].pose
        return torch.cat([pose.p[:, :2].double(), tip_yaw(pose.q.double())[:, None]], -1)

    def hide_goal_marker(self) -> None:
        """Make the goal's disc invisible, until the next `render`."""
        if self._marker is not None:
            self._marker.hide_visual()

    def start(self, scenario: Scenario) -> None:
        """Start an episode in the one scene of a CPU task: `reset` without its overhead."""
        self._initialize_episode(torch.tensor([0]), {"scenarios": [scenario]})

    def set_state_dict(self, state: dict[str, Any], env_idx: Tensor | None = None) -> None:
        """ManiSkill's, and the controller's state with it.

        The state does not hold the layout: to go back to another episode, first
        `reset(options={"scenarios": ...})` with the `scenarios` of that episode.
        """
        super().set_state_dict(state, env_idx)
        if "controller" in state:
            self.agent.controller.set_state(state["controller"])


def _check_backend(num_envs: int, sim_backend: str) -> None:
    on_cpu = not torch.cuda.is_available() or "cpu" in sim_backend
    if on_cpu and (num_envs > 1 or "cuda" in sim_backend):
        raise ValueError(
            f"ClutterPushEnv: num_envs={num_envs} in one task needs CUDA, since on a CPU a task "
            f"holds one scene. Use modpush.envs.PushEnv({num_envs}), or "
            f"gymnasium.make_vec('ClutterPushState-v1', num_envs={num_envs})."
        )


register("ClutterPush-v1", ClutterPushEnv, max_episode_steps=MAX_EPISODE_STEPS)
