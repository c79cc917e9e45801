"""`PushEnv`: a batch of pushing scenes as one TorchRL environment."""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Bounded, Composite, Unbounded, UnboundedDiscrete
from torchrl.envs import EnvBase

from modpush.envs.depth.base import DepthCameraFactory
from modpush.envs.depth.cameras import find_depth_camera
from modpush.envs.depth.image_memory import ImageMemory
from modpush.envs.outcome import is_at_goal, is_out_of_bounds
from modpush.envs.robot.ur5_2f85 import TOOLS, ToolName
from modpush.envs.scenes.objects import PushedObject, get_object_of
from modpush.envs.scenes.obstacle import MAX_OBSTACLES
from modpush.envs.scenes.sampling import sample_scenario
from modpush.envs.scenes.scenario import Scenario, ScenarioConfig
from modpush.envs.sim.batch import SceneBatch, SceneState
from modpush.envs.sim.contacts import CONTACT_KEYS
from modpush.envs.sim.cpu_batch import CpuBatch
from modpush.envs.sim.cuda_batch import CudaBatch
from modpush.envs.sim.rendering import choose_render_backend
from modpush.geometry.camera import CAMERA
from modpush.geometry.workspace import Rectangle

__all__ = ["PushEnv", "PushState"]


@dataclass(frozen=True)
class PushState:
    """A restorable state of some scenes of a `PushEnv`: physics, episode, step counts, randomness."""

    scenes: tuple[SceneState, ...]
    step_count: tuple[int, ...]
    rngs: tuple[Mapping[str, Any], ...]


class PushEnv(EnvBase):
    """Push an object through clutter to a goal; batch size `[num_envs]`.

    It tells the truth of the world and nothing else: the paper's observation and reward are
    transforms on top. On a CPU the scenes are stepped one after the other in this process; for more
    cores use `MultiSyncCollector`, one `PushEnv` a worker. On CUDA they are one batched simulation.

    All lengths in metres, all angles in radians, all poses `[x, y, yaw]` in the robot's base frame:
    x forward, y left, z up, the table's top at z = 0.

    ======================= ==================== =====================================================
    key                     shape, dtype         meaning
    ======================= ==================== =====================================================
    action                  `[B, 3]` float32     (dx, dy, dyaw) of the tool in [-1, 1], times
                                                 (0.02 m, 0.02 m, 0.05 rad)
    depth                   `[B, 1, 256, 256]`   bird's-eye depth along the optical axis [m]; the table
                            float32              is at 1.1 (absent with `depth=None`)
    segmentation            `[B, 1, 256, 256]`   what a pixel shows: 0 table, 1 pushed object,
                            uint8                2 obstacle, 3 robot
    object_pose             `[B, 3]` float32     pose of the pushed object
    goal_position           `[B, 2]` float32     where its centre shall go
    ee_pose                 `[B, 3]` float32     pose of the tool's tip
    joint_position          `[B, 6]` float32     the arm's joints
    object_radius           `[B, 1]` float32     circumscribed radius of the object's footprint
    object_symmetry         `[B, 1]` float32     number of yaw angles at which the object looks the
                                                 same: 4 for a square footprint, 0 for a disc
    object_contact          `[B, 1]` bool        tool or arm touched the object during the step
    obstacle_contact        `[B, 1]` bool        the object touched an obstacle during the step
    tool_obstacle_contact   `[B, 1]` bool        tool or arm touched an obstacle during the step
    target_reachable        `[B, 1]` bool        False where the commanded pose had no solution and the
                                                 target stayed
    obstacle_displacement   `[B, 24]` float32    how far each obstacle was moved since reset (only with
                                                 `dynamic_obstacles=True`)
    success                 `[B, 1]` bool        the object's centre is within 5 cm of the goal
    out_of_bounds           `[B, 1]` bool        its centre is over 5 cm outside the workspace
    reward                  `[B, 1]` float32     1 on success, else 0
    terminated              `[B, 1]` bool        success (and out of bounds with `oob="terminate"`)
    truncated               `[B, 1]` bool        step limit, or out of bounds
    done                    `[B, 1]` bool        either
    ======================= ==================== =====================================================

    Args:
        num_envs: Number of scenes.
        scenario: What episodes are drawn from; or give fields of `ScenarioConfig` one by one
            (`scene="slot"`, `pushed_object="fragment"`, `difficulty=0.5`, ...). May be replaced at
            any time (`env.scenario = ...`) and counts from the next reset on.
        depth: `"analytic"` (cast from the known shapes, needs no renderer), `"sapien"` (rendered), a
            `DepthCamera` of your own (its class, a function that makes it, or `"module:name"`), or
            None. `cast` gives the analytic values with every camera.
        arm_in_depth: Show the arm in the image, as a real camera would. The paper sets the arm's
            pixels to background, which also hides what lies under it; so the default leaves it out.
        tool: `"2f85"`, or `"rod"` as in the authors' code.
        dynamic_obstacles: Make obstacles movable.
        sim_freq: Physics steps a second.
        control_freq: Actions a second.
        max_episode_steps: Truncate after so many steps; None for never.
        oob: Whether leaving the workspace truncates (and so bootstraps) or terminates.
        pictures: Build the scenes with a renderer, for `render`.
        seed: Of the first scene; scene `i` gets `seed + i`, so that it draws the same episodes in a
            batch of any size. None for unpredictable.
        device: `"cpu"` or a CUDA device.

    Raises:
        ValueError: For unknown names, with the list of those there are, and for values out of range.
        RuntimeError: If a renderer is needed and there is none.
    """

    batch_locked = True

    def __init__(
        self,
        num_envs: int = 1,
        *,
        scenario: ScenarioConfig | None = None,
        depth: str | DepthCameraFactory | None = "analytic",
        arm_in_depth: bool = False,
        tool: ToolName = "2f85",
        dynamic_obstacles: bool = False,
        sim_freq: int = 120,
        control_freq: int = 15,
        max_episode_steps: int | None = 200,
        oob: Literal["truncate", "terminate"] = "truncate",
        pictures: bool = False,
        seed: int | None = None,
        device: torch.device | str = "cpu",
        **fields: Any,
    ) -> None:
        _check(num_envs=num_envs, max_episode_steps=max_episode_steps, tool=tool, oob=oob)
        super().__init__(device=torch.device(device), batch_size=torch.Size([num_envs]))
        if scenario is not None and fields:
            raise ValueError(
                f"PushEnv: give either scenario or its fields, got both: {sorted(fields)}."
            )
        self.scenario = scenario if scenario is not None else _scenario_config(fields)
        camera = None if depth is None else find_depth_camera(depth)
        rendering = pictures or getattr(camera, "needs_renderer", False)
        batch = CudaBatch if torch.device(device).type == "cuda" else CpuBatch
        self._batch: SceneBatch = batch(
            num_envs,
            camera,
            arm_in_depth,
            scenario=self.scenario,
            robot_uids=f"ur5_{tool}",
            dynamic_obstacles=dynamic_obstacles,
            sim_freq=sim_freq,
            control_freq=control_freq,
            render_backend=choose_render_backend() if rendering else "none",
        )
        self._objects = self.scenario.objects
        self._tool = TOOLS[tool]
        self._depth, self._dynamic_obstacles = depth, dynamic_obstacles
        self._max_episode_steps, self._oob = max_episode_steps, oob
        self._step_count = np.zeros(num_envs, dtype=np.int64)
        self._goal = np.zeros((num_envs, 2))
        self._radius, self._symmetry = np.zeros((num_envs, 1)), np.zeros((num_envs, 1))
        self._images = ImageMemory(num_envs)
        self._started = False
        self._rngs = [np.random.default_rng() for _ in range(num_envs)]
        self._make_specs()
        if seed is not None:
            self.set_seed(seed)

    def _make_specs(self) -> None:
        B, device = self.batch_size, self.device

        def real(*shape: int) -> Unbounded:
            return Unbounded((*B, *shape), device=device, dtype=torch.float32)

        def flag() -> Binary:
            return Binary(1, (*B, 1), device=device, dtype=torch.bool)

        observation: dict[str, Any] = {
            "object_pose": real(3),
            "goal_position": real(2),
            "ee_pose": real(3),
            "joint_position": real(6),
            "object_radius": real(1),
            "object_symmetry": real(1),
            **{key: flag() for key in CONTACT_KEYS},
            "target_reachable": flag(),
            "success": flag(),
            "out_of_bounds": flag(),
        }
        if self._dynamic_obstacles:
            observation["obstacle_displacement"] = real(MAX_OBSTACLES)
        if self._depth is not None:
            image = (*B, 1, CAMERA.height, CAMERA.width)
            observation["depth"] = Bounded(0.0, CAMERA.z, image, device=device, dtype=torch.float32)
            observation["segmentation"] = UnboundedDiscrete(image, device=device, dtype=torch.uint8)
        self.observation_spec = Composite(observation, shape=B, device=device)
        self.action_spec = Bounded(-1.0, 1.0, (*B, 3), device=device, dtype=torch.float32)
        self.reward_spec = Bounded(0.0, 1.0, (*B, 1), device=device, dtype=torch.float32)
        self.done_spec = Composite(
            {key: flag() for key in ("done", "terminated", "truncated")}, shape=B, device=device
        )

    # ------------------------------------------------------------------ the episode

    def _set_seed(self, seed: int | None) -> None:
        self._rngs = [
            np.random.default_rng(None if seed is None else seed + i)
            for i in range(self.batch_size[0])
        ]

    def _reset(
        self,
        tensordict: TensorDictBase | None = None,
        scenarios: Sequence[Scenario] | None = None,
        **kwargs: Any,
    ) -> TensorDictBase:
        """Start new episodes where `"_reset"` says so (everywhere without it).

        `env.reset(scenarios=[...])` starts from these instead of drawing, one for each scene that
        is reset.
        """
        mask = torch.ones(self.batch_size[0], dtype=torch.bool)
        if tensordict is not None and "_reset" in tensordict.keys():
            mask = tensordict["_reset"].reshape(self.batch_size[0], -1).any(-1).cpu()
        if not self._started and not mask.all():
            raise RuntimeError("PushEnv.reset: the first reset must be of all scenes.")
        indices = torch.nonzero(mask).flatten().tolist()
        if scenarios is None:
            scenarios = [
                sample_scenario(self._rngs[i], self.scenario, tool=self._tool.name) for i in indices
            ]
        elif len(scenarios) != len(indices):
            raise ValueError(
                f"PushEnv.reset: scenarios must have one entry for each of the {len(indices)} "
                f"scenes being reset, got {len(scenarios)}."
            )
        self._batch.start(indices, scenarios)
        self._started = True
        for i in indices:
            self._enter(i)
        self._step_count[indices] = 0
        return self._emit()

    def _enter(self, index: int) -> None:
        """Take over what stays the same through the episode of one scene."""
        scenario = self._batch.scenario(index)
        self._goal[index] = scenario.goal_position
        item = get_object_of(self._objects, scenario.pushed_object)
        self._radius[index], self._symmetry[index] = item.radius, item.symmetry

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        action = tensordict["action"]
        good = (np.abs(action.detach().cpu().numpy()) <= 1.0 + 1e-4).all(-1)  # NaN is not
        if not good.all():
            index = int(np.argmin(good))
            raise ValueError(
                f"PushEnv.step: action of scene {index} must be finite and in [-1, 1], "
                f"got {action[index].tolist()}."
            )
        if not self._started:
            raise RuntimeError("PushEnv.step: call reset first.")
        self._batch.step(action.detach())
        self._step_count += 1
        return self._emit(after_step=True)

    def _emit(self, after_step: bool = False) -> TensorDictBase:
        """What all scenes show now."""
        measured = self._batch.measure()
        position = measured.object_pose[:, :2]
        if not np.isfinite(position).all():
            index = int(np.argmax(~np.isfinite(position).all(-1)))
            raise RuntimeError(f"PushEnv: physics gave a non-finite object pose in scene {index}.")
        # In numpy: on a few numbers it is several times quicker than torch.
        success = is_at_goal(position, self._goal)
        outside = is_out_of_bounds(position, self.bounds)
        limit = self._max_episode_steps
        terminated = success | outside if self._oob == "terminate" else success
        truncated = outside if limit is None else outside | (self._step_count >= limit)
        flags = {
            **{key: measured.contacts[:, i] for i, key in enumerate(CONTACT_KEYS)},
            "target_reachable": measured.target_reachable,
            "success": success,
            "out_of_bounds": outside,
            "terminated": terminated,
            "truncated": truncated,
            "done": terminated | truncated,
        }
        reals = {
            "object_pose": measured.object_pose,
            "goal_position": self._goal,
            "ee_pose": measured.ee_pose,
            "joint_position": measured.joint_position,
            "object_radius": self._radius,
            "object_symmetry": self._symmetry,
        }
        if self._dynamic_obstacles:
            reals["obstacle_displacement"] = self._displacements()
        if after_step:
            reals["reward"] = success[:, None]
        source = {key: torch.from_numpy(value[:, None].copy()) for key, value in flags.items()}
        for key, value in reals.items():
            source[key] = torch.from_numpy(value.astype(np.float32))
        if self._depth is not None:
            source["depth"], source["segmentation"] = self._capture()
        if self.device.type != "cpu":
            source = {key: value.to(self.device) for key, value in source.items()}
        return TensorDict(source, batch_size=self.batch_size, device=self.device)

    def _capture(self) -> tuple[Tensor, Tensor]:
        depth, segmentation = self._images.take()
        for i in range(self.batch_size[0]):
            self._batch.capture(i, depth[i, 0], segmentation[i, 0])
        return torch.from_numpy(depth), torch.from_numpy(segmentation)

    def _displacements(self) -> NDArray[np.float64]:
        moved = np.zeros((self.batch_size[0], MAX_OBSTACLES))
        for i in range(self.batch_size[0]):
            start = np.array([o.pose[:2] for o in self._batch.scenario(i).obstacles])
            if len(start):
                now = self._batch.obstacle_positions(i)
                moved[i, : len(start)] = np.linalg.norm(now - start, axis=-1)
        return moved

    # ------------------------------------------------------------------ beside the episode

    @property
    def scenarios(self) -> list[Scenario]:
        """What the present episodes started from, one for each scene."""
        return [self._batch.scenario(i) for i in range(self.batch_size[0])]

    @property
    def pushed_objects(self) -> dict[str, PushedObject]:
        """The objects that may be pushed, by name."""
        return {item.name: item for item in self._objects}

    @property
    def bounds(self) -> Rectangle:
        """Lower and upper corner of where the object may be, base frame [m]."""
        return self.scenario.bounds()

    def cast(self, index: int, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Depth [m] and label at single pixels `[..., 2]` (u, v) of one scene's image.

        The same values as the image has, without drawing it: for those who need a window only.
        """
        return self._batch.cast(index, pixels)

    def render(self, index: int = 0) -> np.ndarray:
        """A picture of one scene from the side, `[H, W, 3]` uint8.

        Raises:
            RuntimeError: Without `pictures=True`.
        """
        return self._batch.render(index)

    def get_state(self, indices: Sequence[int] | None = None) -> PushState:
        """A copy of the state of some scenes (default: all), to go back to with `set_state`."""
        indices = self._indices(indices)
        return PushState(
            tuple(self._batch.get_state(i) for i in indices),
            tuple(int(self._step_count[i]) for i in indices),
            tuple(self._rngs[i].bit_generator.state for i in indices),
        )

    def set_state(self, state: PushState, indices: Sequence[int] | None = None) -> TensorDictBase:
        """Put scenes into a state; returns what all scenes show then.

        Two continuations from one state are equal to the last bit on a CPU. A continuation may
        differ from the run the state was taken from by PhysX's contact cache, which it does not
        hand out.

        Raises:
            ValueError: If the state is of another number of scenes than `indices`.
        """
        indices = self._indices(indices)
        if len(indices) != len(state.scenes):
            raise ValueError(
                f"PushEnv.set_state: the state holds {len(state.scenes)} scenes, "
                f"expected {len(indices)}."
            )
        if not self._started and len(indices) != self.batch_size[0]:
            raise RuntimeError("PushEnv.set_state: reset or set all scenes first.")
        self._started = True
        for row, i in enumerate(indices):
            self._batch.set_state(i, state.scenes[row])
            self._enter(i)
            self._step_count[i] = state.step_count[row]
            self._rngs[i].bit_generator.state = state.rngs[row]
        return self._emit()

    def _indices(self, indices: Sequence[int] | None) -> Sequence[int]:
        return range(self.batch_size[0]) if indices is None else indices

    def close(self, *, raise_if_closed: bool = True) -> None:
        """Free the simulators."""
        if not self.is_closed:
            self._batch.close()
        super().close(raise_if_closed=raise_if_closed)


def _scenario_config(fields: dict[str, Any]) -> ScenarioConfig:
    known = {field.name for field in dataclasses.fields(ScenarioConfig)}
    if unknown := sorted(set(fields) - known):
        raise ValueError(f"PushEnv: unknown arguments {unknown}, expected some of {sorted(known)}.")
    return ScenarioConfig(**fields)


def _check(*, num_envs: int, max_episode_steps: int | None, tool: str, oob: str) -> None:
    if num_envs < 1:
        raise ValueError(f"PushEnv: num_envs must be >= 1, got {num_envs}.")
    if max_episode_steps is not None and max_episode_steps < 1:
        raise ValueError(
            f"PushEnv: max_episode_steps must be >= 1 or None, got {max_episode_steps}."
        )
    if tool not in TOOLS:
        raise ValueError(f"PushEnv: no tool {tool!r}, expected one of {sorted(TOOLS)}.")
    if oob not in ("truncate", "terminate"):
        raise ValueError(f"PushEnv: oob must be 'truncate' or 'terminate', got {oob!r}.")
