"""The ManiSkill task `ClutterPush-v1`: a UR5 pushes an object through clutter to a goal.

On a CPU one task holds one scene, and obstacles are swapped inside the running scene at every
reset. On CUDA one task holds all scenes, and obstacles come from a pool built once, since bodies
cannot be added to a running GPU simulation.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
import sapien
import torch
from mani_skill.envs.sapien_env import BaseEnv
from mani_skill.sensors.camera import CameraConfig
from mani_skill.utils.registration import TimeLimitWrapper, register
from mani_skill.utils.structs import Actor, Pose
from mani_skill.utils.structs.types import SceneConfig, SimConfig
from sapien import physx
from torch import Tensor

from modpush.envs.robot.kinematics import planar_inverse_kinematics
from modpush.envs.scenes.objects import PushedObject, get_object_of
from modpush.envs.scenes.scenario import BOUNDS_MARGIN, Scenario, ScenarioConfig, sample_scenario
from modpush.envs.sim import bodies
from modpush.envs.sim.agent import UR5, tip_yaw
from modpush.envs.sim.builders import (
    build_goal_marker,
    build_object,
    build_table,
    camera_from_above,
    camera_from_the_side,
    parking_pose,
)
from modpush.envs.sim.contacts import ContactReader
from modpush.envs.sim.cpu_scene import CpuScene
from modpush.envs.sim.obstacle_bodies import ObstaclePool, ObstacleSwapper
from modpush.envs.sim.rendering import NO_RENDERER, find_render_device

__all__ = ["FRICTION", "MAX_EPISODE_STEPS", "ClutterPushEnv", "EpisodeEnd"]

MAX_EPISODE_STEPS = 200
FRICTION: dict[str, float] = {"object": 0.5, "table": 0.5, "obstacle": 0.5, "tool": 0.0}
"""Of the single materials. PhysX takes the mean of two, so the pairs are: object-table 0.5,
tool-object 0.25, object-obstacle 0.5 (spec 1)."""


class ClutterPushEnv(BaseEnv):
    """Push an object to a goal position with a closed gripper, past obstacles.

    Reward modes: `sparse` (1 on reaching the goal) and `none`. Observation modes: ManiSkill's.
    Success terminates; leaving the workspace is reported as `info["out_of_bounds"]` and truncates
    under `gym.make` (`EpisodeEnd`).

    Args:
        scenario: What episodes are drawn from; or give its fields one by one as keywords
            (`scene="slot"`, `pushed_object="fragment"`, ...).
        robot_uids: `ur5_2f85` or `ur5_rod`.
        dynamic_obstacles: Make obstacles movable, 0.5 kg each.
        sim_freq: Physics steps a second.
        control_freq: Actions a second.
        goal_threshold: Success is the object's centre within this of the goal [m].
        bounds_margin: The object is out of bounds when its centre is this far outside the
            workspace [m].
        obstacle_pool: Place things on a CPU as on CUDA: obstacles from a pool, objects parked, mass
            and friction as built. For tests.
        **kwargs: ManiSkill's: `obs_mode`, `render_mode`, `sim_backend`, `num_envs`, ...

    Raises:
        ValueError: For unknown scenes or objects, with the list of those there are.
        RuntimeError: If pictures are asked for and there is no renderer.
    """

    SUPPORTED_ROBOTS: ClassVar[list[str]] = ["ur5_2f85", "ur5_rod"]
    SUPPORTED_REWARD_MODES = ("sparse", "none")
    agent: UR5

    def __init__(
        self,
        *args: Any,
        scenario: ScenarioConfig | None = None,
        robot_uids: str = "ur5_2f85",
        dynamic_obstacles: bool = False,
        sim_freq: int = 120,
        control_freq: int = 15,
        goal_threshold: float = 0.05,
        bounds_margin: float = BOUNDS_MARGIN,
        obstacle_pool: bool = False,
        render_backend: str = "auto",
        **kwargs: Any,
    ) -> None:
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
        self.pushed_objects: list[PushedObject] = self.scenario_config.objects
        self.dynamic_obstacles = dynamic_obstacles
        self.goal_threshold = goal_threshold
        self.bounds_margin = bounds_margin
        self.scenarios: list[Scenario] = []
        self._frequencies = (sim_freq, control_freq)
        self._want_pool = obstacle_pool
        self._rngs: list[np.random.Generator] = []
        if render_backend == "auto":
            pictures = kwargs.get("render_mode") is not None or kwargs.get("obs_mode") not in (
                None,
                "none",
                "state",
                "state_dict",
            )
            render_backend = choose_render_backend() if pictures else "none"
        self._render_name = render_backend
        if render_backend.startswith("pci"):
            render_backend = "cpu"  # `_setup_scene` puts the real one in its place
        super().__init__(*args, robot_uids=robot_uids, render_backend=render_backend, **kwargs)

    # ------------------------------------------------------------------ configuration

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

    # ------------------------------------------------------------------ building

    def _setup_scene(self) -> None:
        # ManiSkill splits "pci:0" at its colon and fails, so the device is put in here.
        if self._render_name.startswith("pci"):
            self.backend.render_device = sapien.Device(self._render_name)
            self._render_device = self.backend.render_device
        super()._setup_scene()

    def _load_agent(self, options: dict[str, Any], *args: Any, **kwargs: Any) -> None:
        super()._load_agent(options, Pose.create_from_pq(), *args, **kwargs)

    def _load_scene(self, options: dict[str, Any]) -> None:
        table, robot, thing = (
            physx.PhysxMaterial(FRICTION[name], FRICTION[name], 0.0)
            for name in ("table", "tool", "object")
        )
        build_table(self, table)
        for link in self.agent.robot.links:
            for raw in link._objs:
                for shape in raw.collision_shapes:
                    shape.physical_material = robot
        self._object_material = thing
        self._actors = {item.name: build_object(self, item, thing) for item in self.pushed_objects}
        obstacle = physx.PhysxMaterial(FRICTION["obstacle"], FRICTION["obstacle"], 0.0)
        pool = self._want_pool or self.gpu_sim_enabled
        self.obstacles = (ObstaclePool if pool else ObstacleSwapper)(
            self.scene, obstacle, self.dynamic_obstacles
        )
        self._marker = build_goal_marker(self) if self.scene.can_render() else None
        self.contacts = ContactReader(self)
        self.cpu_scene = None if pool else CpuScene(self)

    # ------------------------------------------------------------------ episodes

    def reset(
        self,
        seed: int | Sequence[int] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Any, dict[str, Any]]:
        """Start new episodes.

        Args:
            seed: ManiSkill's. A seed decides the whole episode.
            options: ManiSkill's, and `scenarios`: what to start from instead of drawing it, one
                `Scenario` for each scene that is reset.
        """
        if seed is not None:
            seeds = [seed] if isinstance(seed, int | np.integer) else list(seed)
            seeds = (
                seeds
                if len(seeds) == self.num_envs
                else [*range(seeds[0], seeds[0] + self.num_envs)]
            )
            self._rngs = [np.random.default_rng(s) for s in seeds]
        elif not self._rngs:
            self._rngs = [
                np.random.default_rng(s) for s in np.random.SeedSequence().spawn(self.num_envs)
            ]
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
            self._place_objects(scenarios)
            self._place_tool(scenarios)
        self.contacts.clear(env_idx)

    def draw_scenario(self, rng: np.random.Generator) -> Scenario:
        """An episode's start from this task's configuration."""
        return sample_scenario(
            rng, self.scenario_config, tool_half_extents=self.agent.tool.tip_half_extents
        )

    def _place_objects(self, scenarios: Sequence[Scenario]) -> None:
        """On CUDA mass, centre of mass and friction stay as built."""
        for name, actor in self._actors.items():
            item = get_object_of(self.pushed_objects, name)
            parked = parking_pose(self.pushed_objects, item)
            poses = [
                bodies.yaw_pose(*s.object_pose[:2], item.height / 2, s.object_pose[2])
                if s.pushed_object == name
                else parked
                for s in scenarios
            ]
            rows = np.array([[*pose.p, *pose.q] for pose in poses], dtype=np.float32)
            actor.set_pose(Pose.create(torch.from_numpy(rows).to(self.device)))

    def _place_tool(self, scenarios: Sequence[Scenario]) -> None:
        pose = torch.tensor([s.tool_pose for s in scenarios], dtype=torch.float64)
        items = [get_object_of(self.pushed_objects, s.pushed_object) for s in scenarios]
        height = [item.tool_height + self.agent.tool.length for item in items]
        joints, reachable = planar_inverse_kinematics(
            pose, torch.tensor(height, dtype=torch.float64)
        )
        if not reachable.all():
            bad = scenarios[int(torch.argmin(reachable.int()))].tool_pose
            raise ValueError(f"Scenario: tool_pose {bad} is out of the arm's reach.")
        self.agent.reset(joints.float().to(self.device))

    # ------------------------------------------------------------------ stepping

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
        """Success, out of bounds, contact and collisions, each `[num_envs]` bool."""
        position = self.object_pose[:, :2]
        distance = torch.linalg.vector_norm(position - self._goal, dim=-1)
        config, margin = self.scenario_config, self.bounds_margin
        low, high = position.new_tensor(config.low), position.new_tensor(config.high)
        inside = (position >= low - margin) & (position <= high + margin)
        return {
            "success": distance <= self.goal_threshold,
            "out_of_bounds": ~inside.all(-1),
            **self.contacts.flags(),
        }

    def _get_obs_extra(self, info: dict[str, Any]) -> dict[str, Tensor]:
        flags = ("object_contact", "obstacle_contact", "tool_obstacle_contact")
        return {
            "object_pose": self.object_pose.float(),
            "goal_position": self._goal.float(),
            "ee_pose": self.ee_pose.float(),
            **{name: info[name].float()[:, None] for name in flags},
        }

    @property
    def object_actor(self) -> Actor:
        """The pushed body, where all scenes push the same kind of object."""
        names = {s.pushed_object for s in self.scenarios}
        if len(names) != 1:
            raise ValueError(f"object_actor: the scenes push different objects: {sorted(names)}.")
        return self._actors[names.pop()]

    @property
    def object_transform(self) -> Tensor:
        """Position and quaternion (w, x, y, z) of the pushed body, `[num_envs, 7]` [m]."""
        poses = {name: actor.pose.raw_pose for name, actor in self._actors.items()}
        rows = [poses[s.pushed_object][i] for i, s in enumerate(self.scenarios)]
        return torch.stack(rows)

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
        actor = self._actors[self.scenarios[index].pushed_object]
        return np.array(actor.pose.raw_pose[index].tolist())

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

    # ------------------------------------------------------------------ the quick way, CPU only

    def start(self, scenario: Scenario) -> None:
        """Start an episode in the one scene of a CPU task: what `reset` does, less its overhead."""
        self._initialize_episode(torch.tensor([0]), {"scenarios": [scenario]})

    # ------------------------------------------------------------------ state

    def set_state_dict(self, state: dict[str, Any], env_idx: Tensor | None = None) -> None:
        """ManiSkill's, and the controller's state with it.

        The state does not hold the layout: to go back to another episode, first
        `reset(options={"scenarios": ...})` with the `scenarios` that were in force.
        """
        super().set_state_dict(state, env_idx)
        if "controller" in state:
            self.agent.controller.set_state(state["controller"])


def choose_render_backend() -> str:
    """ManiSkill's name for the renderer there is.

    Raises:
        RuntimeError: If there is none; the message says how to get one.
    """
    device = find_render_device()
    if device is None:
        raise RuntimeError(NO_RENDERER)
    return "gpu" if device == "cuda" else device


class EpisodeEnd(TimeLimitWrapper):
    """ManiSkill's time limit, and truncation when the object leaves the workspace."""

    def step(self, action: Any) -> Any:
        """As `gymnasium.Env.step`, batched."""
        observation, reward, terminated, truncated, info = super().step(action)
        return observation, reward, terminated, truncated | info["out_of_bounds"], info


register("ClutterPush-v1", ClutterPushEnv, max_episode_steps=MAX_EPISODE_STEPS)
