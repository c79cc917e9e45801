"""`PlannerSubgoals`: sub-goals on the planned path, and those of earlier steps."""

from abc import abstractmethod
from collections.abc import Sequence
from typing import Annotated, Any, Literal

import torch
from annotated_types import MinLen
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, TensorSpec

from modpush._checks import check_finite, check_spec_has, read_key, stored_next
from modpush._transforms import DescribedTransform, add_unbounded
from modpush._types import NonNegativeInteger, Positive, PositiveFraction
from modpush._validation import checked_arguments
from modpush.geometry.camera import Camera
from modpush.planners.grid_planner import GridPlanner, Planner
from modpush.planners.named import make_planner
from modpush.planners.paths import (
    Paths,
    check_paths,
    fraction_subgoal,
    lookahead_subgoal,
    points_ahead,
)

SubgoalMode = Literal["fraction", "lookahead"]


class PlanTransform(DescribedTransform):
    """Implement `_write`: a transform that plans at every step, and keeps a plan until there is another.

    What it keeps from step to step is in the tensordict.
    """

    _memory: NestedKey
    """Key of an entry that it keeps."""

    @abstractmethod
    def _write(
        self, tensordict: TensorDictBase, before: TensorDictBase | None, advance: bool = False
    ) -> TensorDictBase:
        """Plan, and write the results; `before` is the step before, None at a reset.

        With `advance` the plan is a new one, and not that of stored data once more.
        """

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        # TorchRL restores the values of scenes that are not reset.
        return self._write(tensordict_reset, None)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self._write(next_tensordict, tensordict, advance=True)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Plan for stored data and, in transitions, for their `"next"`.

        The newest plan of stored data is replaced. Observations without a plan and without a `"next"`
        count as the first of an episode.
        """
        after = stored_next(tensordict, self.in_keys, self.out_keys)
        alone = after is None and tensordict.get(self._memory, None) is None
        self._write(tensordict, None if alone else tensordict)
        if after is not None:
            self._step(tensordict, after)
        return tensordict


class PlannerSubgoals(PlanTransform):
    """Plans from the object to the goal at every step and writes the path's length and a sub-goal.

    The state between steps is in the tensordict, under `history_key`, so that copies, workers, partial
    resets and stored data need no special treatment. The planner may cache maps to save time.

    If there is no path, length and sub-goal of the step before are kept and `path_found` is False; at a
    reset they are the straight distance and the goal. For a start or goal that is not free see
    `Paths`.

    Args:
        planner: A planner, see `Planner`; its name in `PLANNERS`; or its `"module:name"`.
            `"distance_field"` is the fastest while map and goal are unchanged.
        camera: The camera and its grid; the same as `OccupancyGrid`'s.
        mode: `"fraction"`: the sub-goal lies at a fraction of the path's length; `"lookahead"`: at a
            distance along the path, but not beyond its first corner.
        fraction: Fraction of the path's length, in (0, 1].
        lookahead: Distance along the path [m].
        lags: Ages of the past sub-goals that are written [steps]; the first sub-goal of the episode
            stands for older ones.
        ahead: Distances along the path of the points that are written, also beyond corners [m]. Where
            there is no path, the points of the step before are kept; at a reset they are the goal. Empty
            for none.
        max_waypoints: Number of waypoints of the path that are written, at least 2: a shorter path is
            padded with its last point, a longer one loses those before the last. 0 for no path.
        occupancy_key: Read, `[..., 1, H, W]` bool.
        object_pose_key: Read, `[..., 3]` (x, y, yaw) in the robot's base frame [m, rad].
        goal_position_key: Read, `[..., 2]` (x, y) in the robot's base frame [m].
        path_length_key: Written and read back, `[..., 1]` float32 [m].
        subgoal_key: Written, `[..., 2]` float32 in the robot's base frame [m].
        subgoal_past_key: Written, `[..., len(lags), 2]` float32 in the robot's base frame [m].
        path_found_key: Written, `[..., 1]` bool.
        history_key: Written and read back, `[..., max(lags) + 1, 2]` float32 [m], newest first.
        path_ahead_key: Written and read back if `ahead` is given, `[..., len(ahead), 2]` float32 in the
            robot's base frame [m].
        path_key: Written if `max_waypoints` > 0, `[..., max_waypoints, 2]` float32 [m].

    Raises:
        TypeError: If the planner has no method `plan`.
        ValueError: If there is no planner of that name, the mode is unknown, or a number is out of
            range.
    """

    @checked_arguments
    def __init__(
        self,
        planner: Planner | str,
        *,
        camera: Camera | None = None,
        mode: SubgoalMode = "fraction",
        fraction: PositiveFraction = 0.2,
        lookahead: Positive = 0.2,
        lags: Annotated[Sequence[NonNegativeInteger], MinLen(1)] = (1, 5),
        ahead: Sequence[Positive] = (),
        max_waypoints: NonNegativeInteger = 0,
        occupancy_key: NestedKey = "occupancy",
        object_pose_key: NestedKey = "object_pose",
        goal_position_key: NestedKey = "goal_position",
        path_length_key: NestedKey = "path_length",
        subgoal_key: NestedKey = "subgoal",
        subgoal_past_key: NestedKey = "subgoal_past",
        path_found_key: NestedKey = "path_found",
        history_key: NestedKey = "subgoal_history",
        path_ahead_key: NestedKey = "path_ahead",
        path_key: NestedKey = "path",
    ) -> None:
        if max_waypoints == 1:
            raise ValueError("PlannerSubgoals: max_waypoints must be 0 or >= 2, got 1.")
        out_keys = [path_length_key, subgoal_key, subgoal_past_key, path_found_key, history_key]
        if ahead:
            out_keys.append(path_ahead_key)
        if max_waypoints:
            out_keys.append(path_key)
        super().__init__(
            in_keys=[occupancy_key, object_pose_key, goal_position_key], out_keys=out_keys
        )
        self.planner = make_planner(planner)
        kind = type(self.planner)
        own_name = f"{kind.__module__}:{kind.__qualname__}"
        self._planner_name = planner if isinstance(planner, str) else own_name
        self.camera = camera or Camera()
        # Planners without a `cell_size` give lengths in pixels.
        self._cell_size = float(getattr(self.planner, "cell_size", 1.0))
        self._metres_per_length = self.camera.cell_size / self._cell_size
        self.mode = mode
        self.fraction = fraction
        self.lookahead = lookahead
        self.lags = tuple(lags)
        self.ahead = tuple(ahead)
        self.max_waypoints = max_waypoints
        self.occupancy_key = occupancy_key
        self.object_pose_key = object_pose_key
        self.goal_position_key = goal_position_key
        self.path_length_key = path_length_key
        self.subgoal_key = subgoal_key
        self.subgoal_past_key = subgoal_past_key
        self.path_found_key = path_found_key
        self.history_key = self._memory = history_key
        self.path_ahead_key = path_ahead_key
        self.path_key = path_key

    def describe(self) -> dict[str, Any]:
        """The planner, and which points of the path are written."""
        return {
            "subgoals": {
                "planner": self._planner_name,
                "mode": self.mode,
                self.mode: getattr(self, self.mode),
                "lags": list(self.lags),
                "ahead": list(self.ahead),
            }
        }

    def _plan(self, tensordict: TensorDictBase) -> tuple[Paths, Tensor, Tensor]:
        """Paths of the flattened batch; object's and goal's positions `[..., 2]` [m]."""
        image = (self.camera.height, self.camera.width)
        occupancy = read_key(tensordict, self.occupancy_key, 1, *image)
        position = read_key(tensordict, self.object_pose_key, 3)[..., :2]
        goal = read_key(tensordict, self.goal_position_key, 2)
        start, end = (self.camera.project(point).reshape(-1, 2) for point in (position, goal))
        try:
            paths = self.planner.plan(occupancy.reshape(-1, *image), start, end)
        except ValueError:  # planners check their ends under other names
            check_finite(repr(self.object_pose_key), position)
            check_finite(repr(self.goal_position_key), goal)
            raise
        if not isinstance(self.planner, GridPlanner):
            check_paths(paths, len(start), start, end, self._cell_size)
        return paths, position, goal

    def _subgoal(self, paths: Paths) -> Tensor:
        """The sub-goal on each path, `[B, 2]` [m]."""
        if self.mode == "fraction":
            pixel = fraction_subgoal(paths, self.fraction)
        else:
            pixel = lookahead_subgoal(paths, self.lookahead / self.camera.cell_size)
        return self.camera.unproject(pixel)

    def _write(
        self, tensordict: TensorDictBase, before: TensorDictBase | None, advance: bool = False
    ) -> TensorDictBase:
        paths, position, goal = self._plan(tensordict)
        position, goal = position.float(), goal.float()
        lead = position.shape[:-1]
        found = paths.found.reshape(*lead, 1)
        length = (paths.length * self._metres_per_length).reshape(*lead, 1)
        subgoal = self._subgoal(paths).reshape(*lead, 2)
        if before is None:
            length = torch.where(found, length, (goal - position).norm(dim=-1, keepdim=True))
            subgoal = torch.where(found, subgoal, goal)
            history = subgoal.unsqueeze(-2).repeat_interleave(max(self.lags) + 1, -2)
        else:
            history = self._history(before)
            earlier_length = read_key(before, self.path_length_key)
            length = torch.where(found, length, earlier_length)
            subgoal = torch.where(found, subgoal, history[..., 0, :])
            rest = history[..., :-1, :] if advance else history[..., 1:, :]
            history = torch.cat([subgoal.unsqueeze(-2), rest], -2)
        tensordict.set(self.path_length_key, length)
        tensordict.set(self.subgoal_key, subgoal)
        tensordict.set(self.subgoal_past_key, history[..., list(self.lags), :])
        tensordict.set(self.path_found_key, found)
        tensordict.set(self.history_key, history)
        if self.ahead:
            tensordict.set(self.path_ahead_key, self._points_ahead(paths, found, goal, before))
        if self.max_waypoints:
            path = self.camera.unproject(_fit(paths.waypoints, self.max_waypoints))
            tensordict.set(self.path_key, path.reshape(*lead, self.max_waypoints, 2))
        return tensordict

    def _points_ahead(
        self, paths: Paths, found: Tensor, goal: Tensor, before: TensorDictBase | None
    ) -> Tensor:
        """Points along each path, `[..., len(ahead), 2]` [m], or their substitute without a path."""
        pixels = points_ahead(paths, [d / self.camera.cell_size for d in self.ahead])
        points = self.camera.unproject(pixels).reshape(*goal.shape[:-1], len(self.ahead), 2)
        if before is None:
            kept = goal.unsqueeze(-2).expand_as(points)
        else:
            kept = read_key(before, self.path_ahead_key, *points.shape[-2:])
        return torch.where(found.unsqueeze(-1), points, kept)

    def _history(self, before: TensorDictBase) -> Tensor:
        """Sub-goals up to the step before, `[..., max(lags) + 1, 2]` [m], newest first."""
        if before.get(self.history_key, None) is None:
            raise KeyError(
                f"PlannerSubgoals: key {self.history_key!r}, which holds the past sub-goals, is missing "
                "in the step before; do not exclude it from the environment's output. There are "
                f"{sorted(map(str, before.keys(True, True)))}."
            )
        return read_key(before, self.history_key, max(self.lags) + 1, 2)

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Add the written keys."""
        check_spec_has(observation_spec, self.in_keys)
        add_unbounded(observation_spec, self.path_length_key, 1)
        add_unbounded(observation_spec, self.subgoal_key, 2)
        add_unbounded(observation_spec, self.subgoal_past_key, len(self.lags), 2)
        add_unbounded(observation_spec, self.history_key, max(self.lags) + 1, 2)
        if self.ahead:
            add_unbounded(observation_spec, self.path_ahead_key, len(self.ahead), 2)
        if self.max_waypoints:
            add_unbounded(observation_spec, self.path_key, self.max_waypoints, 2)
        observation_spec[self.path_found_key] = Binary(
            shape=(*observation_spec.shape, 1), dtype=torch.bool, device=observation_spec.device
        )
        return observation_spec


def _fit(waypoints: Tensor, count: int) -> Tensor:
    """`[B, P, 2]` to `[B, count, 2]`: pad with the last point, or drop points before it."""
    padding = count - waypoints.shape[1]
    if padding >= 0:
        return torch.cat([waypoints, waypoints[:, -1:].expand(-1, padding, 2)], 1)
    return torch.cat([waypoints[:, : count - 1], waypoints[:, -1:]], 1)
