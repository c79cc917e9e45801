"""The pushing-corridor controller of Krivic and Piater, the paper's baseline."""

import math
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import NestedKey, TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.data import Composite
from torchrl.envs.transforms import TensorDictPrimer

from modpush.agents.corridor.config import CorridorConfig
from modpush.agents.corridor.corridor import (
    Clearances,
    corridor_cost,
    corridor_path,
    obstacle_distance,
    outside,
    to_targets,
)
from modpush.agents.corridor.push_learning import activate, correction, learn
from modpush.agents.corridor.push_motion import direction_of, face_way, push_direction, unit
from modpush.agents.corridor.state import state_spec
from modpush.agents.corridor.tool_path import clearances_at, make_room, repulsion, way_behind
from modpush.agents.corridor.von_mises import wrap_angle, wrap_angle_faithful
from modpush.geometry import Camera
from modpush.planners import LazyThetaStar, OccupancyMap


class PushingCorridorController(TensorDictModuleBase):
    """Pushes along a path that keeps clear of obstacles, and learns how the object takes pushes.

    At an episode's first step a path of least cost is planned once. At every step the furthest
    point of it that is seen from the object is the target; the tool goes round the object to get
    behind it with respect to the target, and pushes, the more the better it stands. Where it
    stands well is learned within the episode; deviations of the object are steered against.

    What outlasts a step lives in the tensordict under `state_key`; all of it zero means a new
    episode. Scenes begin anew where `is_init_key` says so, where the state is missing or zero, or
    where the goal is another than before. Use `make_tensordict_primer` to have the state in an
    env's specs; without, rollouts carry it over too.

    Args:
        config: Numbers; `faithful_config()` for the authors' own.
        camera: The camera.
        object_radius: Circumscribed radius of the object [m], where `object_radius_key` is missing.
        depth_key: Read, `[B, 1, H, W]` float32 [m].
        segmentation_key: Read, `[B, 1, H, W]` uint8, values of `Label`.
        object_pose_key: Read, `[B, 3]` (x, y, yaw) [m, rad], robot's base frame.
        ee_pose_key: Read, `[B, 3]`, the tool's.
        goal_position_key: Read, `[B, 2]` [m].
        object_radius_key: Read if there, `[B, 1]` [m].
        is_init_key: Read if there, `[B, 1]` bool, an episode's first step.
        state_key: Read and written, also under `"next"`.
        action_key: Written, `[B, 3]` float32 in [-1, 1]: (dx, dy, dyaw).

    Source: Krivic and Piater, "Pushing corridors for delivering unknown objects with a mobile
        robot" (Autonomous Robots 2019), as implemented by the paper's authors.
    """

    def __init__(
        self,
        config: CorridorConfig | None = None,
        *,
        camera: Camera | None = None,
        object_radius: float = 0.025 * math.sqrt(2.0),
        depth_key: NestedKey = "depth",
        segmentation_key: NestedKey = "segmentation",
        object_pose_key: NestedKey = "object_pose",
        ee_pose_key: NestedKey = "ee_pose",
        goal_position_key: NestedKey = "goal_position",
        object_radius_key: NestedKey = "object_radius",
        is_init_key: NestedKey = "is_init",
        state_key: str = "corridor",
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
        self.is_init_key = is_init_key
        self.state_key = state_key
        self.action_key = action_key
        self.in_keys = [
            depth_key,
            segmentation_key,
            object_pose_key,
            ee_pose_key,
            goal_position_key,
        ]
        self.out_keys = [action_key, state_key, ("next", state_key)]
        self._obstacles = OccupancyMap(self.camera)
        self._navigator = LazyThetaStar()
        self._known: dict[int, tuple[NDArray[Any], NDArray[Any]]] = {}

    def __getstate__(self) -> dict[str, Any]:
        return {**super().__getstate__(), "_known": {}}

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
        """
        for key in self.in_keys:
            if tensordict.get(key, None) is None:
                raise KeyError(
                    f"PushingCorridorController: {key!r} is missing; there is "
                    f"{sorted(map(str, tensordict.keys(True, True)))}."
                )
        lead = tensordict.get(self.object_pose_key).shape[:-1]
        device = tensordict.get(self.object_pose_key).device
        scenes = math.prod(lead)
        read = {
            key: tensordict.get(key).detach().cpu().reshape(scenes, -1)
            for key in (self.object_pose_key, self.ee_pose_key, self.goal_position_key)
        }
        position = read[self.object_pose_key][:, :2].float()
        tool = read[self.ee_pose_key][:, :2].float()
        goal = read[self.goal_position_key].float()
        radius = tensordict.get(self.object_radius_key, None)
        if radius is None:
            radius = torch.full((scenes,), self.object_radius)
        radius = radius.detach().cpu().reshape(scenes).float()
        state = self._begin(tensordict, scenes, goal)
        distances = self._distances(tensordict, scenes)
        self._plan(state, distances, position, goal, radius)
        action = self._act(state, distances, position, tool, radius)
        if self.config.max_turn > 0:
            way = direction_of(state["target"] - position)
            yaw = read[self.ee_pose_key][:, 2].float()
            action[:, 2] = face_way(way, yaw, self.config.max_turn)
        tensordict.set(self.action_key, action.reshape(*lead, 3).to(device))
        state = state.reshape(lead).to(device)
        # Under "next" for envs that have it in their specs; beside the action for all others, whose
        # rollouts carry unknown keys over to the next step.
        tensordict.set(self.state_key, state)
        tensordict.set(("next", self.state_key), state.clone())
        return tensordict

    def _begin(self, tensordict: TensorDictBase, scenes: int, goal: Tensor) -> TensorDict:
        """The state, zero in all scenes that begin anew, `[scenes]`."""
        old = tensordict.get(self.state_key, None)
        if old is None:
            return self.state_spec((scenes,)).zero()
        old = old.detach().cpu().reshape(scenes)
        started = old["started"] & (old["goal"] == goal).all(-1, keepdim=True)
        is_init = tensordict.get(self.is_init_key, None)
        if is_init is not None:
            started = started & ~is_init.cpu().reshape(scenes, 1)
        if started.all():
            return old.clone()
        fresh = self.state_spec((scenes,)).zero()
        return torch.where(started.squeeze(-1), old.select(*fresh.keys()), fresh)

    def _distances(self, tensordict: TensorDictBase, scenes: int) -> list[NDArray[Any]]:
        """Each scene's distances to obstacles; worked out again only where those changed."""
        depth = tensordict.get(self.depth_key)
        images = (scenes, *depth.shape[-2:])
        segments = tensordict.get(self.segmentation_key).reshape(images)
        blocked, bits = self._obstacles(depth.reshape(images), 0.0, segments)
        distances = []
        for b in range(scenes):
            row, known = bits[b].numpy(), self._known.get(b)
            if known is None or not np.array_equal(known[0], row):
                known = row, obstacle_distance(blocked[b].cpu().numpy())
                self._known[b] = known
            distances.append(known[1])
        return distances

    def _plan(
        self,
        state: TensorDict,
        distances: list[NDArray[Any]],
        position: Tensor,
        goal: Tensor,
        radius: Tensor,
    ) -> None:
        """Plan where an episode begins."""
        rows = (~state["started"]).squeeze(-1).nonzero().squeeze(-1)
        if not len(rows):
            return
        distance = torch.from_numpy(np.stack([distances[b] for b in rows.tolist()]))
        cells = radius[rows] / self.camera.cell_size
        cost = corridor_cost(
            distance,
            self.config.inner_zone * cells,
            self.config.outer_zone * cells,
            self.config.weights,
        )
        if self.config.workspace is not None:
            beyond = outside(self.camera, *self.config.workspace)
            cost = torch.where(beyond, self.config.weights[2], cost)
        path = corridor_path(
            distance,
            cost,
            self.camera.project(position[rows]),
            self.camera.project(goal[rows]),
            self.config.path_points,
            self.config.neighbours,
        )
        state["path"][rows] = self.camera.unproject(path)
        state["goal"][rows] = goal[rows]
        state["target"][rows] = goal[rows]
        state["object_position"][rows] = position[rows]

    def _act(
        self,
        state: TensorDict,
        distances: list[NDArray[Any]],
        position: Tensor,
        tool: Tensor,
        radius: Tensor,
    ) -> Tensor:
        """Learn from the last step, choose target and action, `[B, 3]`; updates the state."""
        wrap = wrap_angle_faithful if self.config.faithful else wrap_angle
        learn(state, position, self.config)
        target = self._aim(state, distances, position, tool, radius)
        alpha = wrap(direction_of(position - tool) - direction_of(target - position))
        push, relocate, alpha_p = activate(state, alpha, self.config)
        distance = (position - tool).norm(dim=-1)
        velocity = push_direction(
            position,
            tool,
            alpha,
            alpha_p,
            push,
            relocate,
            distance < radius + self.config.near,
            state["gamma_count"].squeeze(-1) > 0,
            self.config,
        )
        velocity = self._navigate(velocity, relocate, distances, position, target, tool, radius)
        velocity = self._keep_off(state, distances, velocity, relocate, position, tool)
        heading = direction_of(velocity) - correction(state, self.config)
        state["object_position"] = position
        state["tool_position"] = tool
        state["target"] = target
        state["alpha"] = alpha[:, None]
        state["started"] = torch.ones_like(state["started"])
        action = torch.stack([heading.cos(), heading.sin(), torch.zeros_like(heading)], -1)
        return action * self.config.step

    def _aim(
        self,
        state: TensorDict,
        distances: list[NDArray[Any]],
        position: Tensor,
        tool: Tensor,
        radius: Tensor,
    ) -> Tensor:
        """Where to push the object now, `[B, 2]` [m]."""
        config = self.config
        target = to_targets(
            distances,
            state["path"],
            position,
            tool,
            state["target"],
            ~state["started"].squeeze(-1),
            config.behind,
            [
                Clearances(
                    outer=config.outer_zone * cells,
                    inner=config.inner_zone * cells,
                    touch=config.touch_zone * cells,
                )
                for cells in (radius / self.camera.cell_size).tolist()
            ],
            not config.faithful,
            config.tool_room,
            config.path_step,
            self.camera,
        )
        if config.contact == 0:
            return target
        return make_room(
            distances, position, target, radius, config.contact, config.tool_room, self.camera
        )

    def _navigate(
        self,
        velocity: Tensor,
        relocate: Tensor,
        distances: list[NDArray[Any]],
        position: Tensor,
        target: Tensor,
        tool: Tensor,
        radius: Tensor,
    ) -> Tensor:
        """The planned way behind the object, in place of the circle, where the tool must go."""
        clear = clearances_at(distances, position, self.camera)
        tight = (clear < self.config.navigate) & (relocate >= self.config.inversion)
        rows = tight.nonzero().squeeze(-1)
        if not len(rows):
            return velocity
        ahead = way_behind(
            self._navigator,
            [distances[b] for b in rows.tolist()],
            position[rows],
            target[rows],
            tool[rows],
            radius[rows] + self.config.near,
            self.config.tool_room,
            self.camera,
        )
        velocity = velocity.clone()
        velocity[rows] = ahead - tool[rows]
        return velocity

    def _keep_off(
        self,
        state: TensorDict,
        distances: list[NDArray[Any]],
        velocity: Tensor,
        relocate: Tensor,
        position: Tensor,
        tool: Tensor,
    ) -> Tensor:
        """Keep the tool off obstacles, and back off from where nothing moves; updates the state."""
        config = self.config
        push_off = repulsion(distances, tool, config.avoid, self.camera)
        velocity = unit(velocity) + 2.0 * relocate[:, None] * push_off
        if not config.patience:
            return velocity
        rest = (tool - state["tool_position"]).norm(dim=-1) < 0.004
        rest &= (position - state["object_position"]).norm(dim=-1) < 0.002
        rest &= state["started"].squeeze(-1) & (state["escape"].squeeze(-1) == 0)
        still = torch.where(rest, state["still"].squeeze(-1) + 1, 0.0)
        begins = still >= config.patience
        escape = (state["escape"].squeeze(-1) - 1).clamp_min(0)
        escape = torch.where(begins, float(config.escape), escape)
        state["still"] = torch.where(begins, 0.0, still)[:, None]
        state["escape"] = escape[:, None]
        backwards = unit(tool - position) + 2.0 * push_off
        return torch.where((escape > 0)[:, None], backwards, velocity)
