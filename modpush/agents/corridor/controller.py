"""The pushing-corridor controller of Krivic and Piater, the paper's baseline."""

import math
from typing import Any

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase, unravel_key
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.data import Binary, Composite, Unbounded
from torchrl.envs.transforms import TensorDictPrimer

from modpush._checks import check_finite, read_key
from modpush._types import Length
from modpush._validation import checked_arguments
from modpush.agents.corridor.config import CorridorConfig
from modpush.agents.corridor.learning import correction, heading_difference, judge_stance, learn
from modpush.agents.corridor.motion import (
    follow_tool_path,
    keep_off_obstacles,
    push_velocity,
    turn_wide_side,
)
from modpush.agents.corridor.scene import (
    CorridorScene,
    ObstacleDistances,
    plan_object_path,
)
from modpush.agents.corridor.target import choose_targets
from modpush.geometry import Camera
from modpush.geometry.frames import direction_of
from modpush.planners import LazyThetaStar

_SMALL_CUBE_RADIUS = 0.025 * math.sqrt(2.0)  # [m]


class PushingCorridorController(TensorDictModuleBase):
    """Pushes along a path that keeps clear of obstacles, and learns how the object reacts to pushes.

    At the first step of an episode a path of least cost is planned once. At every step the target is
    the furthest point of the path that is visible from the object. The tool goes around the object to
    get behind it with respect to the target, and pushes faster the better it stands behind the object.
    Which position is good is learned within the episode; the controller steers against deviations of
    the object.

    The state of an episode is in the tensordict under `state_key`; a state of zeros means a new episode.
    An episode begins if `is_init_key` says so, if the state is missing or zero, or if the goal has
    changed. `make_tensordict_primer` adds the state to the specs of an environment; rollouts also carry
    it over without.

    Args:
        config: Settings; `faithful_config()` for those of the authors.
        camera: The camera.
        object_radius: Circumscribed radius of the object [m], where `object_radius_key` is missing.
        depth_key: Key of the depth image, read, `[B, 1, H, W]` float32 [m].
        segmentation_key: Key of the labels, read, `[B, 1, H, W]` uint8, see `modpush.geometry`.
        object_pose_key: Key of the object's pose, read, `[B, 3]` (x, y, yaw) [m, rad], robot's base
            frame.
        ee_pose_key: Key of the tool's pose, read, `[B, 3]`.
        goal_position_key: Key of the goal, read, `[B, 2]` [m].
        object_radius_key: Key of the object's circumscribed radius, optional, read, `[B, 1]` [m].
        touch_radius_key: Key of the largest distance from an obstacle at which the object counts as
            touching it, optional, read, `[B, 1]` [m]; by default the configuration alone decides.
        is_init_key: Key that marks an episode's first step, optional, read, `[B, 1]` bool.
        state_key: Key of the controller's state, read and written, also under `"next"`.
        action_key: Key of the action, written, `[B, 3]` float32 in [-1, 1]: (dx, dy, dyaw).

    Source: Krivic and Piater, "Pushing corridors for delivering unknown objects with a mobile
        robot" (Autonomous Robots 2019), as implemented by the paper's authors.
    """

    @checked_arguments
    def __init__(
        self,
        config: CorridorConfig | None = None,
        *,
        camera: Camera | None = None,
        object_radius: Length = _SMALL_CUBE_RADIUS,
        depth_key: NestedKey = "depth",
        segmentation_key: NestedKey = "segmentation",
        object_pose_key: NestedKey = "object_pose",
        ee_pose_key: NestedKey = "ee_pose",
        goal_position_key: NestedKey = "goal_position",
        object_radius_key: NestedKey = "object_radius",
        touch_radius_key: NestedKey = "touch_radius",
        is_init_key: NestedKey = "is_init",
        state_key: NestedKey = "corridor",
        action_key: NestedKey = "action",
    ) -> None:
        super().__init__()
        self.config = config or CorridorConfig()
        self.camera = camera or Camera()
        self.object_radius = object_radius
        self.image_keys = [depth_key, segmentation_key]
        self.pose_keys = [object_pose_key, ee_pose_key, goal_position_key]
        self.object_radius_key, self.touch_radius_key = object_radius_key, touch_radius_key
        self.is_init_key, self.action_key = is_init_key, action_key
        self.state_key = unravel_key(state_key)
        self._next_state_key = unravel_key(("next", state_key))
        self.in_keys = [*self.image_keys, *self.pose_keys]
        self.out_keys = [action_key, self.state_key, self._next_state_key]
        self._distances = ObstacleDistances(self.camera)
        self._tool_planner = LazyThetaStar()

    def state_spec(self, batch: tuple[int, ...]) -> Composite:
        """Spec of the state of a batch of scenes; it is zero before an episode.

        Keys, `[*batch, ...]` float32 unless said otherwise: `started` (1) bool; `path` (path_points, 2)
        and `goal` (2) of the episode [m]; of the last step `target` (2), `object_position` (2),
        `tool_position` (2) [m], `alpha` (1) and the object's deviation `gamma` (1) [rad]; `alphas`
        (max_angles) of successful pushes and their number `alpha_count` (1); `gamma_sum` (2) and
        `gamma_count` (1) over the steps in which the object moved; `still` (1), number of steps without
        motion, and `escape` (1), number of steps left to back off.
        """
        sizes: dict[str, tuple[int, ...]] = {"path": (self.config.path_points, 2)}
        sizes["alphas"] = (self.config.max_angles,)
        for key in ("goal", "target", "object_position", "tool_position", "gamma_sum"):
            sizes[key] = (2,)
        for key in ("alpha", "gamma", "alpha_count", "gamma_count", "still", "escape"):
            sizes[key] = (1,)
        leaves: dict[str, Any] = {
            key: Unbounded(shape=(*batch, *size), dtype=torch.float32)
            for key, size in sizes.items()
        }
        leaves["started"] = Binary(shape=(*batch, 1), dtype=torch.bool)
        return Composite(leaves, shape=batch)

    def make_tensordict_primer(self) -> TensorDictPrimer:
        """Transform that adds the state's spec to an environment, zero at every reset."""
        return TensorDictPrimer({self.state_key: self.state_spec(())}, expand_specs=True)

    @torch.no_grad()
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the action and the next state.

        Args:
            tensordict: `[B]` or one scene without batch dimension.

        Raises:
            KeyError: If a key is missing.
            TypeError: If one is not a tensor of real numbers.
            ValueError: If one has another shape, or a pose is not finite.
        """
        pose = read_key(tensordict, self.pose_keys[0], 3)
        lead, device = pose.shape[:-1], pose.device
        scene = self._observe(tensordict, math.prod(lead))
        state = self._state(tensordict, scene.goal)
        new = (~state["started"]).squeeze(-1).nonzero().squeeze(-1)
        if len(new):
            begun = scene.select(new)
            state["path"][new] = plan_object_path(begun, self.config)
            state["goal"][new] = begun.goal
            state["target"][new] = begun.goal
            state["object_position"][new] = begun.object_position
        action = self._act(scene, state)
        tensordict.set(self.action_key, action.reshape(*lead, 3).to(device))
        state = state.reshape(lead).to(device)
        # Under "next" for envs that have it in their specs; beside the action for all others, whose
        # rollouts carry unknown keys over to the next step.
        tensordict.set(self.state_key, state)
        tensordict.set(self._next_state_key, state.clone())
        return tensordict

    def _observe(self, tensordict: TensorDictBase, num_scenes: int) -> CorridorScene:
        """The observed scenes, on the CPU and with one batch dimension."""
        size = (self.camera.height, self.camera.width)
        depth, segmentation = (
            read_key(tensordict, key, *size).reshape(num_scenes, *size) for key in self.image_keys
        )
        poses = [
            read_key(tensordict, key, width).detach().cpu().reshape(num_scenes, width).float()
            for key, width in zip(self.pose_keys, (3, 3, 2), strict=True)
        ]
        for key, value in zip(self.pose_keys, poses, strict=True):
            check_finite(repr(key), value)
        object_pose, ee_pose, goal = poses
        radius, touch = (
            torch.full((num_scenes,), default, device="cpu")
            if (value := tensordict.get(key, None)) is None
            else value.detach().cpu().reshape(num_scenes)
            for key, default in (
                (self.object_radius_key, self.object_radius),
                (self.touch_radius_key, math.inf),
            )
        )
        return CorridorScene(
            camera=self.camera,
            obstacle_distance=self._distances(depth, segmentation),
            object_position=object_pose[:, :2],
            object_radius=radius.float(),
            tool_position=ee_pose[:, :2],
            tool_yaw=ee_pose[:, 2],
            goal=goal,
            touch_radius=touch.float(),
        )

    def _state(self, tensordict: TensorDictBase, goal: Tensor) -> TensorDict:
        """The state `[B]`, zero in all scenes whose episode begins."""
        scenes = len(goal)
        old: Any = tensordict.get(self.state_key, None)
        if old is None:
            return self.state_spec((scenes,)).zero().cpu()
        old = old.detach().cpu().reshape(scenes)
        started = old["started"] & (old["goal"] == goal).all(-1, keepdim=True)
        is_init: Any = tensordict.get(self.is_init_key, None)
        if is_init is not None:
            started = started & ~is_init.cpu().reshape(scenes, 1)
        if started.all():
            return old.clone()
        zero = self.state_spec((scenes,)).zero().cpu()
        return torch.where(started.squeeze(-1), old.select(*zero.keys()), zero)

    def _act(self, scene: CorridorScene, state: TensorDict) -> Tensor:
        """Learn from the last step, choose a target and move towards it.

        The state holds the object's path and is updated in place. The action is `[B, 3]` float32 in
        [-1, 1]: (dx, dy, dyaw).
        """
        config, position, tool = self.config, scene.object_position, scene.tool_position
        learn(state, position, config)
        target = choose_targets(scene, state, config)
        alpha = heading_difference(position - tool, target - position, config)
        stance = judge_stance(state, alpha, config)
        has_moved = state["gamma_count"].squeeze(-1) > 0
        velocity = push_velocity(scene, stance, has_moved, config)
        velocity = follow_tool_path(
            scene, velocity, target, stance.relocate, config, self._tool_planner
        )
        velocity = keep_off_obstacles(scene, velocity, stance.relocate, state, config)
        heading = direction_of(velocity) - correction(state, config)
        state["object_position"] = position
        state["tool_position"] = tool
        state["target"] = target
        state["alpha"] = alpha[:, None]
        state["started"] = torch.ones_like(state["started"])
        action = torch.stack([heading.cos(), heading.sin(), torch.zeros_like(heading)], -1)
        action = action * config.action_length
        if config.max_turn > 0:
            push = direction_of(target - position)
            action[:, 2] = turn_wide_side(push, scene.tool_yaw, config.max_turn)
        return action
