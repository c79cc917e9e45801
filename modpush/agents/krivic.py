"""The pushing-corridor controller of Krivic and Piater, the paper's baseline."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import NestedKey, TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.data import Binary, Composite, Unbounded
from torchrl.envs.transforms import TensorDictPrimer

from modpush.agents.corridor import (
    Clearances,
    corridor_cost,
    corridor_path,
    obstacle_distance,
    repulsion,
    to_targets,
)
from modpush.agents.von_mises import (
    activations,
    posterior,
    posterior_faithful,
    preferred_angle,
    wrap_angle,
    wrap_angle_faithful,
)
from modpush.planners import GridFrame, OccupancyMap


@dataclass(frozen=True, kw_only=True)
class CorridorConfig:
    """Numbers of `PushingCorridorController`; `faithful_config` gives the authors' own."""

    prior_strength: float = 5.84
    """R0 of the prior on (mu, kappa)."""
    prior_count: float = 7.0
    """c of the prior; with R0 its mode is kappa = 3.37."""
    prior_direction: float = 0.0
    """phi of the prior [rad]."""
    inversion: float = 0.6
    """psi_relocate from which on the tool goes round the object instead of pushing it."""
    approach_gain: float = 1.0
    """Speed towards the object while going round it from afar."""
    retreat_gain: float = 0.1
    """Speed away from it, times psi_relocate, while going round it nearby."""
    near: float = 0.035
    """Nearby begins so far from the object's circumscribed circle [m]."""
    mean_gain: float = 0.05
    """K_mu: share of the mean deviation that is steered against."""
    last_gain: float = 0.1
    """K_gamma: share of the last deviation that is steered against."""
    success: float = math.pi / 6
    """A push that deviated by more is none to learn from, though the one before was worse [rad]."""
    moved: float = 1e-4
    """A step in which the object moved by more counts [m]."""
    inner_zone: float = 1.2
    """Width of the inner zone in circumscribed radii of the object."""
    outer_zone: float = 2.4
    """Width of the outer zone in the same."""
    touch_zone: float = 1.0
    """Room that the object needs, in the same."""
    weights: tuple[float, float, float] = (1.0, 50.0, 200.0)
    """Cost of a free cell, of the outer zone, of the inner zone."""
    neighbours: int = 8
    """Of a cell, for A*."""
    path_points: int = 256
    """Points that the path is held by."""
    behind: float = 0.0816
    """How far behind the object the place to push it from is looked for [m]."""
    window: int = 200
    """How many successful angles are remembered, and at most."""
    step: float = 1.0
    """Length of an action, 1 is the most the environment allows in an axis."""
    lean: float = 1.0
    """An object within the inner zone is pushed off the obstacle, by so much at contact; 0: not."""
    avoid: float = 0.05
    """The tool is pushed off obstacles that are nearer while it goes round the object; 0: not [m]."""
    patience: int = 5
    """After so many steps in which nothing moved the tool backs off; 0: never."""
    escape: int = 8
    """For so many steps."""
    faithful: bool = False
    """Keep the authors' mistakes: their posterior, angle wrapping, means and condition to invert."""

    def __post_init__(self) -> None:
        if not self.prior_count > self.prior_strength >= 0:
            raise ValueError(
                "CorridorConfig: prior_count must exceed prior_strength >= 0, got "
                f"{self.prior_count} and {self.prior_strength}."
            )
        if not 0 < self.step <= 1:
            raise ValueError(f"CorridorConfig: step must lie in (0, 1], got {self.step}.")
        if self.path_points < 2 or self.window < 1:
            raise ValueError(
                "CorridorConfig: path_points must be >= 2 and window >= 1, got "
                f"{self.path_points} and {self.window}."
            )


def faithful_config() -> CorridorConfig:
    """The authors' numbers: zones of 4.24 and 8.49 cm for an object of radius 3.54 cm."""
    radius = 0.025 * math.sqrt(2.0)
    return CorridorConfig(
        near=0.07 - radius,
        success=math.inf,
        lean=0.0,
        avoid=0.0,
        patience=0,
        inner_zone=0.03 * math.sqrt(2.0) / radius,
        outer_zone=0.06 * math.sqrt(2.0) / radius,
        touch_zone=7 * 0.00354 / radius,
        neighbours=4,
        faithful=True,
    )


def direction_of(vector: Tensor) -> Tensor:
    """Heading of `[..., 2]` vectors, `[...]` [rad]."""
    return torch.atan2(vector[..., 1], vector[..., 0])


def unit(vector: Tensor) -> Tensor:
    """`[..., 2]` vectors at length 1; those of no length stay."""
    return vector / vector.norm(dim=-1, keepdim=True).clamp_min(1e-9)


def push_direction(
    object_position: Tensor,
    tool_position: Tensor,
    alpha: Tensor,
    alpha_p: Tensor,
    push: Tensor,
    relocate: Tensor,
    near: Tensor,
    touched: Tensor,
    config: CorridorConfig,
) -> Tensor:
    """Where the tool should go, before steering against deviations.

    Args:
        object_position: `[B, 2]` [m].
        tool_position: `[B, 2]` [m].
        alpha: `[B]` [rad], see `activations`.
        alpha_p: `[B]` [rad].
        push: `[B]`, psi_push.
        relocate: `[B]`, psi_relocate.
        near: `[B]` bool, the tool is close to the object.
        touched: `[B]` bool, the object has moved before.
        config: Thresholds and gains.

    Returns:
        `[B, 2]`, a velocity of order 1.
    """
    forward = unit(object_position - tool_position)
    aside = torch.stack([forward[..., 1], -forward[..., 0]], -1)  # turned by -90 degrees
    side = torch.where(torch.sin(alpha_p - alpha) < 0, -1.0, 1.0)
    aside = aside * side[..., None]
    far_gain = torch.full_like(push, config.approach_gain)
    # Who has touched the object and drifted off comes back while circling, but no faster than the
    # activations say; the first approach goes straight.
    far_gain = torch.where(touched, push, far_gain)
    invert = relocate > config.inversion if config.faithful else relocate >= config.inversion
    gain = torch.where(near, -config.retreat_gain * relocate, far_gain)
    gain = torch.where(invert, gain, push)
    return gain[..., None] * forward + relocate[..., None] * aside


class PushingCorridorController(TensorDictModuleBase):
    """Pushes along a path that keeps clear of obstacles, and learns how the object takes pushes.

    At an episode's first step a path of least cost is planned once. At every step the furthest
    point of it that is seen from the object is the target; the tool goes round the object to get
    behind it with respect to the target, and pushes, the more the better it stands. Where it
    stands well is learned within the episode; deviations of the object are steered against.

    What outlasts a step lives in the tensordict under `state_key`; all of it zero means a new
    episode. Scenes begin anew where `is_init_key` says so, where the state is missing or zero, or
    where the goal is another than before. Use `make_tensordict_primer` to have the state in an
    env's specs, or just run it: rollouts carry it over.

    Args:
        config: Numbers; `faithful_config()` for the authors' own.
        frame: The camera.
        object_radius: Circumscribed radius of the object [m], where `object_radius_key` is missing.
        depth_key: Read, `[B, 1, H, W]` float32 [m].
        segmentation_key: Read, `[B, 1, H, W]` uint8, see `modpush.planners.grid`.
        object_pose_key: Read, `[B, 3]` (x, y, yaw) [m, rad], robot's base frame.
        ee_pose_key: Read, `[B, 3]`, the tool's.
        goal_position_key: Read, `[B, 2]` [m].
        object_radius_key: Read if there, `[B, 1]` [m].
        is_init_key: Read if there, `[B, 1]` bool, an episode's first step.
        state_key: Read, and written under `"next"`.
        action_key: Written, `[B, 3]` float32 in [-1, 1]: (dx, dy, dyaw).

    Source: Krivic and Piater, "Pushing corridors for delivering unknown objects with a mobile
        robot" (Autonomous Robots 2019), as implemented by the paper's authors.
    """

    def __init__(
        self,
        config: CorridorConfig | None = None,
        *,
        frame: GridFrame | None = None,
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
        self.frame = frame or GridFrame()
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
        self.out_keys = [action_key, ("next", state_key)]
        self._obstacles = OccupancyMap(self.frame)
        self._known: dict[int, tuple[NDArray[Any], NDArray[Any]]] = {}

    def __getstate__(self) -> dict[str, Any]:
        return {**super().__getstate__(), "_known": {}}

    def state_spec(self, batch: tuple[int, ...]) -> Composite:
        """Spec of the state for a batch of scenes, `Composite` of shape `batch`."""
        shapes = {
            "path": (self.config.path_points, 2),
            "goal": (2,),
            "target": (2,),
            "object_position": (2,),
            "alpha": (1,),
            "alphas": (self.config.window,),
            "alpha_count": (1,),
            "gamma": (1,),
            "gamma_sum": (2,),
            "gamma_count": (1,),
            "tool_position": (2,),
            "still": (1,),
            "escape": (1,),
        }
        leaves: dict[str, Any] = {
            key: Unbounded(shape=(*batch, *shape), dtype=torch.float32)
            for key, shape in shapes.items()
        }
        leaves["started"] = Binary(shape=(*batch, 1), dtype=torch.bool)
        return Composite(leaves, shape=batch)

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
        state = self._begin(tensordict, scenes, goal, position)
        distances = self._distances(tensordict, scenes)
        self._plan(state, distances, position, goal, radius)
        action = self._act(state, distances, position, tool, radius)
        tensordict.set(self.action_key, action.reshape(*lead, 3).to(device))
        tensordict.set(("next", self.state_key), state.reshape(lead).to(device))
        return tensordict

    def _begin(
        self, tensordict: TensorDictBase, scenes: int, goal: Tensor, position: Tensor
    ) -> TensorDict:
        """The state, zero in all scenes that begin anew, `[scenes]`."""
        fresh = self.state_spec((scenes,)).zero()
        old = tensordict.get(self.state_key, None)
        if old is None:
            return fresh
        old = old.detach().cpu().reshape(scenes)
        started = old["started"] & (old["goal"] == goal).all(-1, keepdim=True)
        is_init = tensordict.get(self.is_init_key, None)
        if is_init is not None:
            started = started & ~is_init.cpu().reshape(scenes, 1)
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
        cells = radius[rows] / self.frame.cell_size
        cost = corridor_cost(
            distance,
            self.config.inner_zone * cells,
            self.config.outer_zone * cells,
            self.config.weights,
        )
        path = corridor_path(
            distance,
            cost,
            self.frame.to_pixel(position[rows]),
            self.frame.to_pixel(goal[rows]),
            self.config.path_points,
            self.config.neighbours,
        )
        state["path"][rows] = self.frame.to_metre(path)
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
        self._learn(state, position)
        first = ~state["started"].squeeze(-1)
        config = self.config
        target = to_targets(
            distances,
            state["path"],
            position,
            tool,
            state["target"],
            first,
            config.behind,
            [
                Clearances(
                    outer=config.outer_zone * cells,
                    inner=config.inner_zone * cells,
                    touch=config.touch_zone * cells,
                )
                for cells in (radius / self.frame.cell_size).tolist()
            ],
            not config.faithful,
            self.frame,
        )
        if config.lean > 0:
            reach = float(radius.max()) * config.inner_zone
            push_off = repulsion(distances, position, reach, self.frame)
            way = target - position
            target = position + way + config.lean * way.norm(dim=-1, keepdim=True) * push_off
        alpha = wrap(direction_of(position - tool) - direction_of(target - position))
        push, relocate, alpha_p = self._activate(state, alpha)
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
        velocity = self._keep_off(state, distances, velocity, relocate, position, tool)
        heading = direction_of(velocity) - self._correction(state)
        state["object_position"] = position
        state["tool_position"] = tool
        state["target"] = target
        state["alpha"] = alpha[:, None]
        state["started"] = torch.ones_like(state["started"])
        action = torch.stack([heading.cos(), heading.sin(), torch.zeros_like(heading)], -1)
        return action * self.config.step

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
        push_off = repulsion(distances, tool, config.avoid, self.frame)
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

    def _activate(self, state: TensorDict, alpha: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        config = self.config
        alphas = state["alphas"].double()
        valid = torch.arange(config.window) < state["alpha_count"]
        if config.faithful:
            mu, kappa = posterior_faithful(
                alphas, valid, config.prior_strength, config.prior_direction
            )
        else:
            mu, kappa = posterior(
                alphas, valid, config.prior_strength, config.prior_count, config.prior_direction
            )
        alpha_p = preferred_angle(alphas, valid, mu, kappa, circular=not config.faithful)
        push, relocate = activations(alpha.double(), alpha_p, mu, kappa, config.faithful)
        return push.float(), relocate.float(), alpha_p.float()

    def _learn(self, state: TensorDict, position: Tensor) -> None:
        """Note how the object went, and the angle if it went straighter than before."""
        moved_by = position - state["object_position"]
        moved = (moved_by.norm(dim=-1) > self.config.moved) & state["started"].squeeze(-1)
        wanted = state["target"] - state["object_position"]
        wrap = wrap_angle_faithful if self.config.faithful else wrap_angle
        gamma = wrap(direction_of(moved_by) - direction_of(wanted))
        before, count = state["gamma"].squeeze(-1), state["gamma_count"].squeeze(-1)
        success = moved & (count > 0) & (gamma.abs() < before.abs().clamp_max(self.config.success))
        rows = success.nonzero().squeeze(-1)
        slot = state["alpha_count"].squeeze(-1).long().clamp_max(self.config.window - 1)
        state["alphas"][rows, slot[rows]] = state["alpha"][rows, 0]
        state["alpha_count"][rows] += 1
        state["alpha_count"].clamp_(max=self.config.window)
        rows = moved.nonzero().squeeze(-1)
        state["gamma"][rows, 0] = gamma[rows]
        state["gamma_count"][rows] += 1
        terms = torch.stack([gamma.cos(), gamma.sin()], -1)
        if self.config.faithful:
            terms = torch.stack([torch.ones_like(gamma), gamma], -1)  # numbers, not directions
        state["gamma_sum"][rows] += terms[rows]

    def _correction(self, state: TensorDict) -> Tensor:
        """What to steer against, `[B]` [rad]."""
        total, count = state["gamma_sum"], state["gamma_count"].squeeze(-1)
        if self.config.faithful:
            mean = total[:, 1] / count.clamp_min(1)
        else:
            mean = torch.atan2(total[:, 1], total[:, 0])
        last = state["gamma"].squeeze(-1)
        return self.config.mean_gain * mean + self.config.last_gain * last
