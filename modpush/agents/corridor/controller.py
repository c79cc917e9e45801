"""The pushing-corridor controller of Krivic and Piater, the paper's baseline."""

import math
from typing import Any

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase, unravel_key
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.data import Composite
from torchrl.envs.transforms import TensorDictPrimer

from modpush._arguments import checked_arguments
from modpush._checks import check_finite
from modpush._keys import read_key
from modpush._types import Length
from modpush.agents.corridor.action import choose_action
from modpush.agents.corridor.config import CorridorConfig
from modpush.agents.corridor.corridor_path import plan_object_path
from modpush.agents.corridor.obstacle_distance import ObstacleDistances
from modpush.agents.corridor.scene import CorridorScene
from modpush.agents.corridor.state import state_spec
from modpush.geometry import Camera
from modpush.planners import LazyThetaStar

_WHO = "PushingCorridorController"
_SMALL_CUBE_RADIUS = 0.025 * math.sqrt(2.0)  # [m]


class PushingCorridorController(TensorDictModuleBase):
    """Pushes along a path that keeps clear of obstacles, and learns how the object reacts to pushes.

    At the first step of an episode a path of least cost is planned once. At every step the target is
    the furthest point of the path that is visible from the object. The tool goes around the object to
    get behind it with respect to the target, and pushes the harder, the better its position is. Which
    position is good is learned within the episode; the controller steers against deviations of the
    object.

    Everything that outlasts a step is in the tensordict under `state_key`; a state of zeros means a new
    episode. A scene starts anew if `is_init_key` says so, if the state is missing or zero, or if the
    goal has changed. Use `make_tensordict_primer` to have the state in the specs of an environment;
    rollouts also carry it over without.

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
        object_radius_key: Key of the object's circumscribed radius, read if there, `[B, 1]` [m].
        touch_radius_key: Key of the largest distance from an obstacle at which the object counts as
            touching it, read if there, `[B, 1]` [m]; by default the configuration alone decides.
        is_init_key: Key that marks an episode's first step, read if there, `[B, 1]` bool.
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
        self.depth_key, self.segmentation_key = depth_key, segmentation_key
        self.object_pose_key, self.ee_pose_key = object_pose_key, ee_pose_key
        self.goal_position_key = goal_position_key
        self.object_radius_key = object_radius_key
        self.touch_radius_key = touch_radius_key
        self.is_init_key = is_init_key
        self.state_key = unravel_key(state_key)
        self.action_key = action_key
        self.in_keys = [
            depth_key,
            segmentation_key,
            object_pose_key,
            ee_pose_key,
            goal_position_key,
        ]
        self._next_state_key = unravel_key(("next", state_key))
        self.out_keys = [action_key, self.state_key, self._next_state_key]
        self._distances = ObstacleDistances(self.camera)
        self._tool_planner = LazyThetaStar()

    def state_spec(self, batch: tuple[int, ...]) -> Composite:
        """Spec of the state for a batch of scenes, `Composite` of shape `batch`."""
        return state_spec(self.config, batch)

    def make_tensordict_primer(self) -> TensorDictPrimer:
        """A transform that gives an env the state's spec, zero at every reset."""
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
        pose = self._read(tensordict, self.object_pose_key, 3)
        lead, device = pose.shape[:-1], pose.device
        scene = self._observe(tensordict, math.prod(lead))
        state = self._begin(tensordict, scene.goal)
        rows = (~state["started"]).squeeze(-1).nonzero().squeeze(-1)
        if len(rows):
            fresh = scene.select(rows)
            state["path"][rows] = plan_object_path(fresh, self.config)
            state["goal"][rows] = fresh.goal
            state["target"][rows] = fresh.goal
            state["object_position"][rows] = fresh.object_position
        action = choose_action(scene, state, self.config, self._tool_planner)
        tensordict.set(self.action_key, action.reshape(*lead, 3).to(device))
        state = state.reshape(lead).to(device)
        # Under "next" for envs that have it in their specs; beside the action for all others, whose
        # rollouts carry unknown keys over to the next step.
        tensordict.set(self.state_key, state)
        tensordict.set(self._next_state_key, state.clone())
        return tensordict

    def _read(self, tensordict: TensorDictBase, key: NestedKey, *last: int) -> Tensor:
        return read_key(_WHO, tensordict, key, *last)

    def _observe(self, tensordict: TensorDictBase, scenes: int) -> CorridorScene:
        """What is read, on the CPU and with one batch dimension."""
        size = (self.camera.height, self.camera.width)
        images = [
            self._read(tensordict, key, *size) for key in (self.depth_key, self.segmentation_key)
        ]
        depth, segmentation = (image.reshape(scenes, *image.shape[-2:]) for image in images)
        object_pose, ee_pose, goal = (
            self._read(tensordict, key, width).detach().cpu().reshape(scenes, width).float()
            for key, width in (
                (self.object_pose_key, 3),
                (self.ee_pose_key, 3),
                (self.goal_position_key, 2),
            )
        )
        for key, value in (
            (self.object_pose_key, object_pose),
            (self.ee_pose_key, ee_pose),
            (self.goal_position_key, goal),
        ):
            check_finite(_WHO, repr(key), value)
        radius, touch = (
            torch.full((scenes,), default, device="cpu")
            if value is None
            else value.detach().cpu().reshape(scenes)
            for key, default in (
                (self.object_radius_key, self.object_radius),
                (self.touch_radius_key, math.inf),
            )
            for value in [tensordict.get(key, None)]
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

    def _begin(self, tensordict: TensorDictBase, goal: Tensor) -> TensorDict:
        """The state, zero in all scenes that begin anew, `[B]`."""
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
        fresh = self.state_spec((scenes,)).zero().cpu()
        return torch.where(started.squeeze(-1), old.select(*fresh.keys()), fresh)
