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

from modpush.envs import bodies
from modpush.envs.camera import CAMERA
from modpush.envs.contacts import ContactReader
from modpush.envs.kinematics import planar_inverse_kinematics
from modpush.envs.objects import PushedObject, get_object
from modpush.envs.obstacles import ObstaclePool, ObstacleSwapper
from modpush.envs.rendering import NO_RENDERER, find_render_device
from modpush.envs.robot import UR5, tip_yaw
from modpush.envs.scenarios import Scenario, ScenarioConfig, sample_scenario
from modpush.envs.shapes import box

__all__ = ["FRICTION", "MAX_EPISODE_STEPS", "ClutterPushEnv", "EpisodeEnd"]

MAX_EPISODE_STEPS = 200
FRICTION: dict[str, float] = {"object": 0.5, "table": 0.5, "obstacle": 0.5, "tool": 0.0}
"""Of the single materials. PhysX takes the mean of two, so the pairs are: object-table 0.5,
tool-object 0.25, object-obstacle 0.5 (spec 1)."""
_PARKED = (20.0, 0.0)  # where objects that are not in play rest [m]


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
        obstacle_pool: Take obstacles from a pool even on a CPU (on CUDA it is always so).
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
        bounds_margin: float = 0.05,
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
        return [
            CameraConfig(
                uid="bird_eye",
                pose=CAMERA.sapien_pose(),
                width=CAMERA.width,
                height=CAMERA.height,
                fov=CAMERA.fov,
                near=0.01,
                far=10.0,
            )
        ]

    @property
    def _default_human_render_camera_configs(self) -> CameraConfig:
        pose = sapien.Pose([1.35, 0.75, 0.85])
        forward = np.array([0.40, 0.0, 0.05]) - pose.p
        pose.q = _look_along(forward)
        return CameraConfig(
            "render_camera", pose, 512, 512, 0.75, 0.01, 10.0, shader_pack="default"
        )

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
        self._load_table(table)
        for link in self.agent.robot.links:
            for raw in link._objs:
                for shape in raw.collision_shapes:
                    shape.physical_material = robot
        self._object_material = thing
        self._actors = {item.name: self._load_object(item) for item in self.pushed_objects}
        obstacle = physx.PhysxMaterial(FRICTION["obstacle"], FRICTION["obstacle"], 0.0)
        pool = self._want_pool or self.gpu_sim_enabled
        self.obstacles = (ObstaclePool if pool else ObstacleSwapper)(
            self.scene, obstacle, self.dynamic_obstacles
        )
        self._marker = self._load_goal_marker() if self.scene.can_render() else None
        self.contacts = ContactReader(self)
        self._mass_properties: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        self._raw_joints = [joint._objs[0] for joint in self.agent.robot.active_joints]

    def _load_table(self, material: physx.PhysxMaterial) -> None:
        """An endless plane to rest on, and a table top to see."""
        for i, sub_scene in enumerate(self.scene.sub_scenes):
            entity = sapien.Entity()
            if i == 0 or not self.gpu_sim_enabled:  # one plane serves all GPU scenes
                body = physx.PhysxRigidStaticComponent()
                plane = physx.PhysxCollisionShapePlane(material)
                plane.local_pose = sapien.Pose(q=[np.sqrt(0.5), 0, -np.sqrt(0.5), 0])
                _never_touch_base(plane)
                body.attach(plane)
                entity.add_component(body)
            if self.scene.can_render():
                top = box(3.0, 3.0, 0.04, (0.6, 0.0, -0.02), color=(0.93, 0.91, 0.87))
                bodies.attach_visuals(entity, [top])
            entity.name = f"scene-{i}_table"
            sub_scene.add_entity(entity)
        for raw in self.agent.robot.links_map["base"]._objs:
            for shape in raw.collision_shapes:
                _never_touch_base(shape)

    def _load_goal_marker(self) -> Actor:
        """A disc of the goal's size, for people: cameras that make observations do not see it."""
        builder = self.scene.create_actor_builder()
        builder.add_cylinder_visual(
            pose=sapien.Pose(q=[np.sqrt(0.5), 0, np.sqrt(0.5), 0]),
            radius=self.goal_threshold,
            half_length=0.0005,
            material=sapien.render.RenderMaterial(base_color=[0.1, 0.75, 0.2, 1.0]),
        )
        builder.initial_pose = sapien.Pose([0.5, 0.0, 0.0])
        marker = builder.build_kinematic("goal")
        self.scene.remove_from_state_dict_registry(marker)
        self._hidden_objects.append(marker)
        return marker

    def _load_object(self, item: PushedObject) -> Actor:
        """One body of this kind per scene, with mass and inertia of a homogeneous solid."""
        entities = []
        for i, sub_scene in enumerate(self.scene.sub_scenes):
            entity = bodies.rigid_body(item.parts, self._object_material, mass=item.mass)
            if self.scene.can_render():
                bodies.attach_visuals(entity, item.parts)
            entity.name = f"scene-{i}_{item.name}"
            entity.pose = self._parking_pose(item)
            sub_scene.add_entity(entity)
            entities.append(entity)
        actor = Actor.create_from_entities(
            entities, self.scene, torch.arange(self.num_envs), shared_name=item.name
        )
        actor.initial_pose = Pose.create(self._parking_pose(item), device=self.device)
        self.scene.actors[item.name] = actor
        self.scene.add_to_state_dict_registry(actor)
        return actor

    def _parking_pose(self, item: PushedObject) -> sapien.Pose:
        index = [other.name for other in self.pushed_objects].index(item.name)
        return bodies.yaw_pose(_PARKED[0], _PARKED[1] + index, item.height / 2, 0.0)

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
        self._place_objects(env_idx, scenarios)
        self._place_tool(env_idx, scenarios)
        self.contacts.clear(env_idx)

    def draw_scenario(self, rng: np.random.Generator) -> Scenario:
        """An episode's start from this task's configuration."""
        return sample_scenario(
            rng, self.scenario_config, tool_half_extents=self.agent.tool.tip_half_extents
        )

    def _place_objects(self, env_idx: Tensor, scenarios: Sequence[Scenario]) -> None:
        if not self.gpu_sim_enabled:
            # Only what is in play is in the scene, and it is taken out and put in again: a body
            # leaves PhysX's contact cache behind, and the episode does not depend on the one before,
            # to the last bit.
            scene = self.scene.sub_scenes[0]
            for actor in self._actors.values():
                if actor._objs[0].scene is not None:
                    scene.remove_entity(actor._objs[0])
            item = get_object_of(self.pushed_objects, scenarios[0].pushed_object)
            scene.add_entity(self._actors[item.name]._objs[0])
        for name, actor in self._actors.items():
            item = get_object_of(self.pushed_objects, name)
            poses = np.array(
                [
                    np.concatenate([pose.p, pose.q])
                    for pose in (
                        bodies.yaw_pose(*s.object_pose[:2], item.height / 2, s.object_pose[2])
                        if s.pushed_object == name
                        else self._parking_pose(item)
                        for s in scenarios
                    )
                ],
                dtype=np.float32,
            )
            actor.set_pose(Pose.create(torch.from_numpy(poses).to(self.device)))
            if not self.gpu_sim_enabled:
                for s in scenarios:
                    if s.pushed_object == name:
                        self._set_dynamics(actor, item, s)

    def _set_dynamics(self, actor: Actor, item: PushedObject, scenario: Scenario) -> None:
        """Mass, centre of mass and friction of the episode. On CUDA they stay as built."""
        wanted = scenario.dynamics
        body = actor._bodies[0]
        # As built, once: read and written again at every reset, they would drift by roundings.
        unit, axes = self._mass_properties.setdefault(
            item.name, (np.array(body.inertia) / body.mass, np.array(body.cmass_local_pose.q))
        )
        body.mass = wanted.mass
        body.inertia = unit * wanted.mass
        body.cmass_local_pose = sapien.Pose([*wanted.center_of_mass, 0.0], axes)
        self._object_material.static_friction = wanted.friction
        self._object_material.dynamic_friction = wanted.friction

    def _place_tool(self, env_idx: Tensor, scenarios: Sequence[Scenario]) -> None:
        pose = torch.tensor([s.tool_pose for s in scenarios], dtype=torch.float64)
        height = torch.tensor(
            [
                get_object_of(self.pushed_objects, s.pushed_object).tool_height
                + self.agent.tool.length
                for s in scenarios
            ],
            dtype=torch.float64,
        )
        joints, reachable = planar_inverse_kinematics(pose, height)
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
        actor = self._actors[self.scenarios[index].pushed_object]
        if self.gpu_sim_enabled:
            return np.array(actor.pose.raw_pose[index].tolist())
        pose = actor._bodies[0].entity_pose
        return np.concatenate([pose.p, pose.q], dtype=np.float64)

    def link_transforms_of(self, index: int, names: Sequence[str]) -> np.ndarray:
        """The same for links of the robot, `[len(names), 7]` [m]."""
        links = self.agent.robot.links_map
        if self.gpu_sim_enabled:
            return np.array([links[name].pose.raw_pose[index].tolist() for name in names])
        poses = [links[name]._objs[0].entity_pose for name in names]
        return np.array([np.concatenate([pose.p, pose.q]) for pose in poses], dtype=np.float64)

    @property
    def ee_pose(self) -> Tensor:
        """x, y, yaw of the tool's tip, `[num_envs, 3]` float64 [m, m, rad]."""
        pose = self.agent.robot.links_map["tip"].pose
        return torch.cat([pose.p[:, :2].double(), tip_yaw(pose.q.double())[:, None]], -1)

    # ------------------------------------------------------------------ the quick way, CPU only

    def start(self, scenario: Scenario) -> None:
        """Start an episode in the one scene of a CPU task: what `reset` does, less its overhead."""
        self._clear_sim_state()
        self._initialize_episode(torch.tensor([0]), {"scenarios": [scenario]})

    def advance(self, position: list[list[float]], velocity: list[list[float]]) -> None:
        """One control step of a CPU task, given drive targets: `step` less its overhead.

        Args:
            position: For every substep the six joint targets [rad].
            velocity: For every substep the six joint velocities [rad/s].
        """
        px, contacts = self.scene.px, self.contacts
        joints = self._raw_joints
        sample_at = contacts.sample_at(len(position))
        contacts.row = [False] * len(contacts.row)
        last: list[float] | None = None
        for substep, (angles, rates) in enumerate(zip(position, velocity, strict=True), start=1):
            for joint, angle in zip(joints, angles, strict=True):
                joint.set_drive_target(angle)
            if rates != last:
                for joint, rate in zip(joints, rates, strict=True):
                    joint.set_drive_velocity_target(rate)
                last = rates
            px.step()
            if substep in sample_at:
                contacts.read()

    # ------------------------------------------------------------------ state

    def set_state_dict(self, state: dict[str, Any], env_idx: Tensor | None = None) -> None:
        """ManiSkill's, and the controller's state with it.

        The state does not hold the layout: to go back to another episode, first
        `reset(options={"scenarios": ...})` with the `scenarios` that were in force.
        """
        super().set_state_dict(state, env_idx)
        if "controller" in state:
            self.agent.controller.set_state(state["controller"])


def get_object_of(items: Sequence[PushedObject], name: str) -> PushedObject:
    """The object of this name among those a task was built with."""
    for item in items:
        if item.name == name:
            return item
    get_object(name)  # says so if there is no such object at all
    raise ValueError(
        f"pushed_object: {name!r} was not loaded, this environment has "
        f"{[item.name for item in items]}."
    )


def choose_render_backend() -> str:
    """ManiSkill's name for the renderer there is.

    Raises:
        RuntimeError: If there is none; the message says how to get one.
    """
    device = find_render_device()
    if device is None:
        raise RuntimeError(NO_RENDERER)
    return "gpu" if device == "cuda" else device


def _never_touch_base(shape: physx.PhysxCollisionShape) -> None:
    """Two shapes with this bit never collide: the robot's base stands on the table for good."""
    groups = list(shape.collision_groups)
    groups[2] |= 1 << 30
    shape.set_collision_groups(groups)


def _look_along(forward: np.ndarray) -> np.ndarray:
    """Quaternion of a camera that looks along a direction, upright."""
    x = forward / np.linalg.norm(forward)
    y = np.cross([0.0, 0.0, 1.0], x)
    y /= np.linalg.norm(y)
    from transforms3d.quaternions import mat2quat

    return mat2quat(np.stack([x, y, np.cross(x, y)], 1))


class EpisodeEnd(TimeLimitWrapper):
    """ManiSkill's time limit, and truncation when the object leaves the workspace."""

    def step(self, action: Any) -> Any:
        """As `gymnasium.Env.step`, batched."""
        observation, reward, terminated, truncated, info = super().step(action)
        return observation, reward, terminated, truncated | info["out_of_bounds"], info


register("ClutterPush-v1", ClutterPushEnv, max_episode_steps=MAX_EPISODE_STEPS)
