"""`PushTask`: the scenes of a `PushEnv` as ManiSkill builds them.

On a CPU one task holds one scene, which `SapienEngine` places and steps. On CUDA one task holds all
scenes, ManiSkill steps them, and obstacles come from a pool, since bodies cannot be added to a running
GPU simulation.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, ClassVar

import sapien
import torch
from mani_skill.envs.sapien_env import BaseEnv
from mani_skill.sensors.camera import CameraConfig
from mani_skill.utils.structs import Pose
from mani_skill.utils.structs.types import SimConfig
from torch import Tensor

from modpush.envs.engines.base import SceneSpec
from modpush.envs.engines.sapien.agent import PushArm, agent_class
from modpush.envs.engines.sapien.builders import (
    build_goal_marker,
    build_table,
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
from modpush.envs.outcome import GOAL_THRESHOLD
from modpush.envs.scenes.scenario import Scenario


class PushTask(BaseEnv):
    """Arm, table, objects and obstacles of `num_envs` scenes; more than one needs the CUDA backend.

    `options` are those of ManiSkill's `BaseEnv`.

    Raises:
        ValueError: For several scenes without CUDA.
        RuntimeError: If a renderer is needed and there is none.
    """

    SUPPORTED_ROBOTS = None  # of any class of `agent_class`, which ManiSkill would warn of
    SUPPORTED_REWARD_MODES: ClassVar[tuple[str, ...]] = ("none",)
    agent: PushArm
    goal_threshold = GOAL_THRESHOLD
    """Radius of the marker at the goal [m]."""

    def __init__(
        self,
        spec: SceneSpec,
        num_envs: int = 1,
        sim_backend: str = "auto",
        render_backend: str = "auto",
        **options: Any,
    ) -> None:
        on_cpu = not torch.cuda.is_available() or "cpu" in sim_backend
        if on_cpu and (num_envs > 1 or "cuda" in sim_backend):
            raise ValueError(
                f"{type(self).__name__}: num_envs={num_envs} in one task needs CUDA, since on a CPU a "
                f"task holds one scene. Use modpush.envs.PushEnv({num_envs}), or "
                f"gymnasium.make_vec('modpush/Push-v0', num_envs={num_envs})."
            )
        self.scene_spec = spec  # Gymnasium sets `spec`, to one of its own
        self.scenarios: list[Any] = [None] * num_envs
        """Present episode of each scene; None before its first."""
        if render_backend == "auto":
            render_backend = choose_render_backend() if spec.rendered else "none"
        self._render_name = render_backend
        super().__init__(
            num_envs=num_envs,
            sim_backend=sim_backend,
            # `_setup_scene` puts the real one in its place.
            render_backend="cpu" if render_backend.startswith("pci") else render_backend,
            **{"obs_mode": "none", "robot_uids": agent_class(spec.robot, spec.tool), **options},
        )

    @property
    def _default_sim_config(self) -> SimConfig:
        return simulation_config(self.scene_spec.sim_freq, self.scene_spec.control_freq)

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
        pose = Pose.create_from_pq(torch.tensor([self.scene_spec.robot.base]))
        super()._load_agent(options, pose, *args, **kwargs)

    def _load_scene(self, options: dict[str, Any]) -> None:
        scene, robot = self.scene, self.agent.robot
        base = robot.links_map[self.scene_spec.robot.links[0].name]
        build_table(scene, base, make_material("table"))
        set_material(robot, make_material("tool"))
        self.objects = ObjectBodies(scene, self.scene_spec.objects, make_material("object"))
        self.marker = build_goal_marker(scene, self.goal_threshold) if scene.can_render() else None
        """Disc at the goal, where there is a renderer."""
        if self.marker is not None:
            self._hidden_objects.append(self.marker)
        actors = list(self.objects.actors.values())
        self.obstacles: Any
        self.contacts: Any
        self.engine: SapienEngine | None = None
        """Places and steps the one scene of a CPU task."""
        material, dynamic = make_material("obstacle"), self.scene_spec.dynamic_obstacles
        if self.gpu_sim_enabled:
            pool = self.obstacles = ObstaclePool(scene, material, dynamic)
            self.contacts = CudaContacts(scene, robot, actors, pool.actors)
        else:
            swapper = self.obstacles = ObstacleSwapper(scene, material, dynamic)
            self.contacts = CpuContacts(scene, robot, actors, swapper)
            self.engine = SapienEngine(self)

    def _initialize_episode(self, env_idx: Tensor, options: dict[str, Any]) -> None:
        """On CUDA, begin the episodes `options["scenarios"]` in scenes; the first reset has none."""
        scenarios: Sequence[Scenario] = options.get("scenarios", ())
        if not scenarios:
            return
        if any(o.motion is not None for scenario in scenarios for o in scenario.obstacles):
            raise ValueError(
                "PushEnv: obstacles must have motion=None on CUDA, got one that moves by itself."
            )
        placed = self.obstacles.place(env_idx.tolist(), [s.obstacles for s in scenarios])
        for i, scenario, obstacles in zip(env_idx.tolist(), scenarios, placed, strict=True):
            self.scenarios[i] = replace(scenario, obstacles=obstacles)
        if self.marker is not None:
            goals = torch.tensor([[*s.goal_position, 0.0005] for s in scenarios])
            self.marker.set_pose(Pose.create_from_pq(goals.to(self.device)))
        self.objects.place(scenarios)
        tip_height = [self.objects.item(s.pushed_object).tool_height for s in scenarios]
        self.agent.place_tip([s.tool_pose for s in scenarios], tip_height)
