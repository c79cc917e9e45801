"""`PushEnv`: a batch of pushing scenes as one TorchRL environment."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.envs import EnvBase

from modpush._types import Scenes, Seed
from modpush._validation import check_value, checked_arguments
from modpush.envs.arguments import (
    check_action,
    check_device,
    check_new_scenario,
    check_reach,
    check_scenarios,
    check_tolerance,
    chosen_scenes,
    scenes_to_reset,
)
from modpush.envs.depth.analytic import find_depth_camera
from modpush.envs.engines.base import SceneSpec, default_sim_freq, find_engine
from modpush.envs.outcome import episode_status, is_at_goal, pose_errors
from modpush.envs.push_state import (
    PushState,
    check_state,
    make_generators,
    object_digest,
)
from modpush.envs.robot.named import find_robot, find_tool
from modpush.envs.robot.robot import Robot, Tool
from modpush.envs.scene_batch import SceneBatch
from modpush.envs.scenes.sampling import sample_scenario
from modpush.envs.scenes.scenario import Scenario, ScenarioConfig
from modpush.envs.set_fields import set_fields
from modpush.envs.simulation_config import SimulationConfig
from modpush.envs.specs import make_specs, state_entries
from modpush.geometry.workspace import Rectangle


class PushEnv(EnvBase):
    """Push an object through clutter to a goal; batch size `[num_envs]`.

    It emits the true state of the world; the paper's observation and reward are transforms on top.
    On a CPU the scenes are stepped one after the other in this process; to use more cores, give each
    worker of a `MultiSyncCollector` its own `PushEnv`. On CUDA, which is experimental and untested,
    they are one batched simulation.

    All lengths in metres, all angles in radians, all poses `[x, y, yaw]` in the robot's base frame:
    x forward, y left, z up, the table's top at z = 0.

    ============================ ================== =====================================================
    key                          shape, dtype       meaning
    ============================ ================== =====================================================
    action                       `[B, 3]` float32   (dx, dy, dyaw) of the tool in [-1, 1], times (0.02 m,
                                                    0.02 m, 0.05 rad)
    depth                        `[B, 1, 256, 256]` bird's-eye depth along the optical axis [m]; the
                                 float32            table is at 1.1 (absent with `depth=None`)
    segmentation                 `[B, 1, 256, 256]` what each pixel shows: 0 table, 1 pushed object, 2
                                 uint8              obstacle, 3 robot
    object_pose                  `[B, 3]` float32   pose of the pushed object
    goal_position                `[B, 2]` float32   goal of the object's centre
    goal_pose                    `[B, 3]` float32   goal of the object (only with `goal="pose"`)
    pose_error                   `[B, 2]` float32   distance of the object from that goal [m], and the
                                                    angle by which it is to be turned, modulo its
                                                    symmetry (only with `goal="pose"`)
    ee_pose                      `[B, 3]` float32   pose of the tool's tip
    joint_position               `[B, n]` float32   angles of the arm's joints
    object_radius                `[B, 1]` float32   circumscribed radius of the object's footprint
    object_inscribed_radius      `[B, 1]` float32   radius of the circle inside the object's footprint
    object_symmetry              `[B, 1]` float32   number of yaw angles at which the object looks the
                                                    same: 4 for a square footprint, 0 for a disc
    object_support               `[B, 48]` float32  how far the footprint reaches from the object's
                                                    centre in 48 directions, the first along its own x
    tool_half_extents            `[B, 2]` float32   half of the sides, along its x and y, of the tool's
                                                    parts that reach below the top of the highest
                                                    obstacle, or less than 2 mm above; at least its tip's
    object_contact               `[B, 1]` bool      tool or arm touched the object during the step
    obstacle_contact             `[B, 1]` bool      the object touched an obstacle during the step
    tool_obstacle_contact        `[B, 1]` bool      tool or arm touched an obstacle during the step
    object_contact_at_end        `[B, 1]` bool      the same as `object_contact` at the step's end
    obstacle_contact_at_end      `[B, 1]` bool      the same as `obstacle_contact` there
    tool_obstacle_contact_at_end `[B, 1]` bool      the same as `tool_obstacle_contact` there
    target_reachable             `[B, 1]` bool      False if the arm cannot reach the commanded pose
    obstacle_displacement        `[B, 24]` float32  how far each obstacle has moved since reset (only
                                                    with `dynamic_obstacles=True`)
    obstacle_pose                `[B, 24, 4]`       x, y, yaw of each obstacle, and the tilt of its
                                 float32            vertical axis; zeros where there are fewer (only with
                                                    `dynamic_obstacles=True`)
    obstacle_motion              `[B, 4]` float32   place of the centre (x, y) and velocity (x, y) [m/s]
                                                    of the obstacle nearest to the object of those that
                                                    move by themselves, zeros where none does (only with
                                                    `obstacle_motion=True`)
    object_dynamics              `[B, 4]` float32   mass [kg], friction and centre of mass (x, y) in the
                                                    object's frame (only with `object_dynamics=True`)
    success                      `[B, 1]` bool      the object's centre is within `position_tolerance` of
                                                    the goal, 5 cm by default, and with `goal="pose"` its
                                                    yaw within `yaw_tolerance`, for `hold_steps` steps
    out_of_bounds                `[B, 1]` bool      that centre is more than 5 cm outside the workspace
    reward                       `[B, 1]` float32   1 on success, else 0
    terminated                   `[B, 1]` bool      success (and out of bounds with `oob="terminate"`)
    truncated                    `[B, 1]` bool      step limit, or out of bounds
    done                         `[B, 1]` bool      terminated or truncated
    ============================ ================== =====================================================

    `reset(tensordict, scenarios=None, seed=None, state=None)` starts new episodes in the scenes where
    the key `"_reset"` is True, or in all scenes without that key. With `scenarios` they start from
    these, one for each scene to reset, instead of being drawn. With `seed` the random numbers of scene
    `i` start from `seed + i`, as `set_seed` does for all scenes. With `state` the scenes are put
    into a state of `get_state`, also through transforms; TorchRL refuses a state whose episode is done.

    Args:
        num_envs: Number of scenes.
        scenario: Settings from which episodes are drawn. It may be replaced (`env.scenario = ...`),
            which takes effect at the next reset.
        simulation: Engine, robot, tool, goal, depth camera, rates and ends of episodes.
        pictures: Let `render` show the arm from the side. SAPIEN needs a renderer for it, MuJoCo none.
        seed: Seed of the first scene; scene `i` gets `seed + i`, so that it draws the same episodes
            in a batch of any size, and seeds less than `num_envs` apart have episodes in common. None
            for unpredictable episodes.
        device: `"cpu"` or a CUDA device.
        **fields: Fields of `scenario` and `simulation` to set differently (`scene="slot"`,
            `pushed_object="fragment"`, `depth=None`, `goal="pose"`, ...).

    Raises:
        TypeError: For unknown arguments; the message lists the known ones.
        ValueError: For unknown names (the message lists the known ones), and for values out of range.
        RuntimeError: If a renderer or a CUDA device is needed and there is none.
        ImportError: If a package is not installed that the engine needs; the message names it.
    """

    batch_locked = True

    @checked_arguments
    def __init__(
        self,
        num_envs: Scenes = 1,
        *,
        scenario: ScenarioConfig | None = None,
        simulation: SimulationConfig | None = None,
        pictures: bool = False,
        seed: Seed | None = None,
        device: torch.device | str = "cpu",
        **fields: Any,
    ) -> None:
        check_device(torch.device(device))
        super().__init__(device=torch.device(device), batch_size=torch.Size([num_envs]))
        self._scenario, self._simulation = set_fields(
            "PushEnv", fields, scenario or ScenarioConfig(), simulation or SimulationConfig()
        )
        self.bounds: Rectangle = self._scenario.bounds()
        """Lower and upper corner of where the object may be without being out of bounds [m]."""
        engine = self._simulation.engine
        self._make_engine = find_engine(engine)  # before any work
        self.robot: Robot = find_robot(self._simulation.robot)
        """The arm."""
        self.tool: Tool = find_tool(self._simulation.tool)
        """Its tool."""
        check_reach(self.robot, self._scenario)
        if self._simulation.sim_freq is None:
            rate = default_sim_freq(engine, self._make_engine)
            self._simulation = replace(self._simulation, sim_freq=rate)
        if self.device.type == "cuda" and engine != "sapien":
            raise ValueError(
                f"PushEnv: on a CUDA device engine must be 'sapien', got {engine!r}; it runs on 'cpu'."
            )
        self.pushed_objects = {item.name: item for item in self._scenario.objects}
        """The objects that may be pushed, by name."""
        self._batch = self._build_batch(pictures)
        self.is_closed = False  # TorchRL says True, and would not close it then
        self._digests = {name: object_digest(item) for name, item in self.pushed_objects.items()}
        self._step_count, self._started = np.zeros(num_envs, dtype=np.int64), False
        self._steps_at_goal = np.zeros(num_envs, dtype=np.int64)
        self.yaw_tolerance = self._simulation.yaw_tolerance
        """Largest difference of the object's yaw from a goal pose's at success [rad]: that of
        `simulation`, unless a curriculum sets another one."""
        check_tolerance(self._scenario, self._simulation)
        self._set_seed(seed)
        specs = make_specs(num_envs, self.device, len(self.robot.joints), self._simulation)
        for name, spec in specs.items():
            setattr(self, name, spec)

    def _build_batch(self, pictures: bool) -> SceneBatch:
        config = self._simulation
        assert config.sim_freq is not None
        camera = None if config.depth is None else find_depth_camera(config.depth)
        spec = SceneSpec(
            robot=self.robot,
            tool=self.tool,
            objects=tuple(self.pushed_objects.values()),
            sim_freq=config.sim_freq,
            control_freq=config.control_freq,
            dynamic_obstacles=config.dynamic_obstacles,
            rendered=pictures or getattr(camera, "needs_renderer", False),
        )
        seen = camera, config.arm_in_depth, config.full_circle
        if self.device.type == "cuda":
            from modpush.envs.engines.sapien.cuda_batch import CudaBatch

            return CudaBatch(self.batch_size[0], spec, *seen)
        return SceneBatch(self.batch_size[0], self._make_engine, spec, *seen)

    @property
    def scenario(self) -> ScenarioConfig:
        """Settings from which episodes are drawn, from the next reset on."""
        return self._scenario

    @scenario.setter
    def scenario(self, config: ScenarioConfig) -> None:
        if not isinstance(config, ScenarioConfig):
            raise TypeError(f"PushEnv: scenario must be a ScenarioConfig, got {config!r}.")
        if config is not self._scenario:
            check_new_scenario(config, self._scenario, self._simulation, self._digests)
            # The workspace is the same, for which the reach has been checked.
            if config.max_start_radius != self._scenario.max_start_radius:
                check_reach(self.robot, config)
        self._scenario = config

    def _set_seed(self, seed: int | None) -> None:
        self._rngs = make_generators(seed, self.batch_size[0])

    def _reset(
        self,
        tensordict: TensorDictBase | None = None,
        scenarios: Sequence[Scenario] | None = None,
        seed: int | None = None,
        state: PushState | None = None,
    ) -> TensorDictBase:
        """Start new episodes; the arguments are explained in the docstring of `PushEnv`."""
        self._check_open("reset")
        indices = scenes_to_reset(tensordict, self.batch_size[0])
        if not self._started and len(indices) < self.batch_size[0]:
            raise RuntimeError("PushEnv.reset: the first reset must be of all scenes.")
        if state is not None:
            if scenarios is not None or seed is not None:
                raise ValueError("PushEnv.reset: with state, scenarios and seed must be None.")
            return self.set_state(state, indices)
        if scenarios is not None:
            given = self.tool, self.robot, self._simulation, self.yaw_tolerance
            check_scenarios(scenarios, len(indices), self.bounds, *given, self.pushed_objects)
        if seed is not None:
            check_value("seed", seed, Seed)
            for i in indices:
                self._rngs[i] = np.random.default_rng(int(seed) + i)
        if scenarios is None:
            parts: Any = {"tool": self.tool, "robot": self.robot, "goal": self._simulation.goal}
            scenarios = [sample_scenario(self._rngs[i], self.scenario, **parts) for i in indices]
        self._batch.start(indices, scenarios)
        self._started = True
        self._step_count[indices] = self._steps_at_goal[indices] = 0
        return self._observe()

    def _check_open(self, what: str, started: bool = False) -> None:
        if self.is_closed:
            raise RuntimeError(f"PushEnv.{what}: the environment has been closed.")
        if started and not self._started:
            raise RuntimeError(f"PushEnv.{what}: call reset first.")

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        self._check_open("step", started=True)
        action = tensordict["action"].detach()
        check_action(action, self.batch_size[0])
        self._batch.step(action)
        self._step_count += 1
        return self._observe(after_step=True)

    def _observe(self, after_step: bool = False) -> TensorDictBase:
        """All keys of the present state; the reward only after a step."""
        batch, config = self._batch, self._simulation
        measured, pose_error = batch.measure(), None
        position = measured.object_pose[:, :2]
        at_goal = is_at_goal(position, batch.goal_pose[:, :2], config.position_tolerance)
        if config.goal == "pose":
            symmetry = batch.about_object["object_symmetry"][:, 0]
            pose_error = pose_errors(measured.object_pose, batch.goal_pose, symmetry)
            at_goal &= np.abs(pose_error[:, 1]) <= self.yaw_tolerance
        steps_at_goal = np.maximum(self._steps_at_goal + after_step, 1)
        self._steps_at_goal = np.where(at_goal, steps_at_goal, 0)
        status = episode_status(
            self._steps_at_goal >= config.hold_steps,
            position,
            self.bounds,
            self._step_count,
            config.max_episode_steps,
            config.oob,
        )
        entries = state_entries(batch, measured, status, pose_error)
        if config.dynamic_obstacles:
            entries |= batch.obstacle_entries()
        if config.obstacle_motion:
            entries["obstacle_motion"] = batch.moving.nearest(position)
        if config.object_dynamics:
            entries["object_dynamics"] = batch.object_dynamics()
        if after_step:
            entries["reward"] = entries["success"].float()
        if config.depth is not None:
            entries["depth"], entries["segmentation"] = batch.capture()
        return TensorDict(entries, batch_size=self.batch_size, device=self.device)

    @property
    def scenarios(self) -> list[Scenario]:
        """Starts of the present episodes, one for each scene."""
        self._check_open("scenarios", started=True)
        return list(self._batch.scenarios)

    @property
    def simulation(self) -> SimulationConfig:
        """Engine, robot, tool, goal, camera, rates and ends; `sim_freq` is never None here."""
        return self._simulation

    @property
    def engine_name(self) -> str:
        """Name of the physics engine."""
        return self._batch.engines[0].name

    def __repr__(self) -> str:
        settings = f"scenario={self.scenario!r}, simulation={self.simulation!r}"
        return f"PushEnv({self.batch_size[0]}, {settings})"

    @property
    def _state_config(self) -> dict[str, Any]:
        """Settings that a state depends on, besides the objects."""
        engine, config = self._batch.engines[0], self._simulation
        return {
            "device": self.device.type,
            "engine": f"{engine.name} {engine.version}",
            "robot": self.robot.name,
            "tool": self.tool.name,
            "sim_freq": config.sim_freq,
            "control_freq": config.control_freq,
            "dynamic_obstacles": config.dynamic_obstacles,
        }

    def render(self, index: int = 0) -> np.ndarray:
        """A picture of a scene, `[H, W, 3]` uint8: drawn from above, or rendered with `pictures`."""
        self._check_open("render", started=True)
        (index,) = chosen_scenes([index], self.batch_size[0])
        return self._batch.render(index, self._simulation.position_tolerance)

    def get_state(self, indices: Sequence[int] | None = None) -> PushState:
        """A copy of the state of some scenes (default: all), for `set_state` and `reset`."""
        self._check_open("get_state", started=True)
        chosen = chosen_scenes(indices, self.batch_size[0])
        return PushState(
            scenes=tuple(self._batch.get_state(i) for i in chosen),
            step_count=tuple(self._step_count[chosen].tolist()),
            steps_at_goal=tuple(self._steps_at_goal[chosen].tolist()),
            rngs=tuple(dict(self._rngs[i].bit_generator.state) for i in chosen),
            config=self._state_config,
            objects=self._digests,
        )

    def set_state(self, state: PushState, indices: Sequence[int] | None = None) -> TensorDictBase:
        """Put scenes into a state and return all keys; under transforms use `reset(state=...)`.

        Continuations of one state are equal to the last bit on a CPU, also in another environment. One
        may differ from the run that the state was taken from, in SAPIEN by PhysX's contact cache.

        Raises:
            TypeError: If it is not a `PushState`.
            ValueError: If it is damaged or of another environment; then nothing has changed.
        """
        self._check_open("set_state")
        chosen = chosen_scenes(indices, self.batch_size[0])
        if not self._started and len(chosen) != self.batch_size[0]:
            raise RuntimeError("PushEnv.set_state: reset or set all scenes first.")
        check_state(state, len(chosen), self._state_config, self._digests, self._simulation.goal)
        for i, scene in zip(chosen, state.scenes, strict=True):
            self._batch.check_state(i, scene)
        self._started = True
        for i, scene, rng in zip(chosen, state.scenes, state.rngs, strict=True):
            self._batch.set_state(i, scene)
            self._rngs[i].bit_generator.state = rng
        self._step_count[chosen] = state.step_count
        self._steps_at_goal[chosen] = state.steps_at_goal
        return self._observe()

    def close(self, *, raise_if_closed: bool = True) -> None:
        """Free the simulators; the environment cannot be used any more. Closing twice does nothing."""
        if not self.is_closed:
            self._batch.close()
        super().close(raise_if_closed=raise_if_closed)
