"""Sub-goals on the planned path, with the ones of earlier steps."""

from collections.abc import Sequence
from typing import Literal, get_args

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, TensorSpec, Unbounded
from torchrl.envs import Transform

from modpush.geometry.camera import Camera
from modpush.planners.base import Paths, Planner, point_along

SubgoalMode = Literal["fraction", "lookahead"]


def fraction_subgoal(paths: Paths, fraction: float) -> Tensor:
    """The point after a fraction of each path's length.

    Args:
        paths: Of B scenes.
        fraction: In [0, 1].

    Returns:
        `[B, 2]` [px].
    Source: Sec. IV-A of the paper, 20 % of the global path.
    """
    lengths = (paths.waypoints[:, 1:] - paths.waypoints[:, :-1]).norm(dim=-1).sum(-1)
    return point_along(paths.waypoints, fraction * lengths)


def lookahead_subgoal(paths: Paths, distance: float) -> Tensor:
    """The point a distance along each path, but not past its first corner.

    Args:
        paths: Of B scenes. If a start was moved, the leg out to free space does not count as the
            first segment.
        distance: [px].

    Returns:
        `[B, 2]` [px].
    Source: what the authors' code does in place of the fraction.
    """
    legs = (paths.waypoints[:, 1:] - paths.waypoints[:, :-1]).norm(dim=-1)  # [B, P-1]
    first = legs[:, 0]
    if legs.shape[1] > 1:
        first = torch.where(paths.start_moved, first + legs[:, 1], first)
    return point_along(paths.waypoints, first.clamp_max(distance))


class PlannerSubgoals(Transform):
    """Plans from the object to the goal at every step and writes the way's length and a sub-goal.

    All that outlasts a step lives in the tensordict, in `subgoal_history`: copies, workers, partial
    resets and stored data are right by construction. The planner itself may remember maps, but only
    to save work.

    Where there is no path, length and sub-goal of the step before are kept and `path_found` says
    so; at a reset they are the straight distance and the goal. A start or goal that is not free is
    not an error: see `Paths`.

    Args:
        planner: What plans; `DistanceField` is the fastest while map and goal stand still.
        camera: The camera and its grid; the same as `OccupancyGrid`'s.
        mode: `"fraction"`, a fraction of the path's length on, or `"lookahead"`, a distance on but
            not past the first corner.
        fraction: For the first, in (0, 1].
        lookahead: For the second [m].
        lags: Write the sub-goals of so many steps ago; at an episode's beginning its first one.
        max_waypoints: Write the path too, padded with its last point to so many; a longer one loses
            those before its last. 0 for none, else at least 2.
        occupancy_key: Read, `[..., 1, H, W]` bool.
        object_pose_key: Read, `[..., 3]` (x, y, yaw) [m, rad], robot's base frame.
        goal_position_key: Read, `[..., 2]` (x, y) [m].
        path_length_key: Written, `[..., 1]` float32 [m].
        subgoal_key: Written, `[..., 2]` float32 [m], robot's base frame.
        subgoal_past_key: Written, `[..., len(lags), 2]` float32 [m].
        path_found_key: Written, `[..., 1]` bool.
        history_key: Written and read back, `[..., max(lags) + 1, 2]` float32 [m], newest first.
        path_key: Written if `max_waypoints` > 0, `[..., max_waypoints, 2]` float32 [m].

    Raises:
        ValueError: If the mode is unknown or a number out of its range.
    """

    def __init__(
        self,
        planner: Planner,
        *,
        camera: Camera | None = None,
        mode: SubgoalMode = "fraction",
        fraction: float = 0.2,
        lookahead: float = 0.2,
        lags: Sequence[int] = (1, 5),
        max_waypoints: int = 0,
        occupancy_key: NestedKey = "occupancy",
        object_pose_key: NestedKey = "object_pose",
        goal_position_key: NestedKey = "goal_position",
        path_length_key: NestedKey = "path_length",
        subgoal_key: NestedKey = "subgoal",
        subgoal_past_key: NestedKey = "subgoal_past",
        path_found_key: NestedKey = "path_found",
        history_key: NestedKey = "subgoal_history",
        path_key: NestedKey = "path",
    ) -> None:
        _check_numbers(mode, fraction, lookahead, lags, max_waypoints)
        self.planner = planner
        self.camera = camera or Camera()
        self.mode = mode
        self.fraction = fraction
        self.lookahead = lookahead
        self.lags = tuple(lags)
        self.max_waypoints = max_waypoints
        self.occupancy_key = occupancy_key
        self.object_pose_key = object_pose_key
        self.goal_position_key = goal_position_key
        self.path_length_key = path_length_key
        self.subgoal_key = subgoal_key
        self.subgoal_past_key = subgoal_past_key
        self.path_found_key = path_found_key
        self.history_key = history_key
        self.path_key = path_key
        out_keys = [path_length_key, subgoal_key, subgoal_past_key, path_found_key, history_key]
        if max_waypoints:
            out_keys.append(path_key)
        super().__init__(
            in_keys=[occupancy_key, object_pose_key, goal_position_key], out_keys=out_keys
        )

    def _write(
        self, tensordict: TensorDictBase, before: TensorDictBase | None, advance: bool
    ) -> TensorDictBase:
        """Plan, and write.

        Args:
            tensordict: Read and written.
            before: Where the values of the step before are; None at an episode's beginning.
            advance: Push the sub-goal into the history, rather than replace the newest.
        """
        occupancy, position, goal = self._read(tensordict)
        lead = position.shape[:-1]
        paths = self.planner.plan(
            occupancy.reshape(-1, *occupancy.shape[-2:]),
            self.camera.project(position).reshape(-1, 2),
            self.camera.project(goal).reshape(-1, 2),
        )
        if self.mode == "fraction":
            pixel = fraction_subgoal(paths, self.fraction)
        else:
            pixel = lookahead_subgoal(paths, self.lookahead / self.camera.cell_size)
        found = paths.found.reshape(*lead, 1)
        length = (paths.length * (self.camera.cell_size / self.planner.cell_size)).reshape(*lead, 1)
        subgoal = self.camera.unproject(pixel).reshape(*lead, 2)

        history = None if before is None else before.get(self.history_key, None)
        if before is None or history is None:
            length = torch.where(found, length, (goal - position).norm(dim=-1, keepdim=True))
            subgoal = torch.where(found, subgoal, goal)
            history = subgoal.unsqueeze(-2).repeat_interleave(max(self.lags) + 1, -2)
        else:
            length = torch.where(found, length, before.get(self.path_length_key))
            subgoal = torch.where(found, subgoal, history[..., 0, :])
            rest = history[..., :-1, :] if advance else history[..., 1:, :]
            history = torch.cat([subgoal.unsqueeze(-2), rest], -2)
        tensordict.set(self.path_length_key, length)
        tensordict.set(self.subgoal_key, subgoal)
        tensordict.set(self.subgoal_past_key, history[..., list(self.lags), :])
        tensordict.set(self.path_found_key, found)
        tensordict.set(self.history_key, history)
        if self.max_waypoints:
            path = self.camera.unproject(_fit(paths.waypoints, self.max_waypoints))
            tensordict.set(self.path_key, path.reshape(*lead, self.max_waypoints, 2))
        return tensordict

    def _read(self, tensordict: TensorDictBase) -> tuple[Tensor, Tensor, Tensor]:
        for key in self.in_keys:
            if tensordict.get(key, None) is None:
                raise KeyError(
                    f"PlannerSubgoals: {key!r} is missing; there is "
                    f"{sorted(map(str, tensordict.keys(True, True)))}."
                )
        occupancy = tensordict.get(self.occupancy_key)
        expected = (1, self.camera.height, self.camera.width)
        if occupancy.shape[-3:] != expected:
            raise ValueError(
                f"PlannerSubgoals: {self.occupancy_key!r} must be [..., 1, H, W] = "
                f"[..., {', '.join(map(str, expected))}], got {list(occupancy.shape)}."
            )
        position = tensordict.get(self.object_pose_key)[..., :2]
        return occupancy, position, tensordict.get(self.goal_position_key)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        # TorchRL puts back the old values of scenes that are not being reset.
        return self._write(tensordict_reset, None, advance=False)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self._write(next_tensordict, tensordict, advance=True)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Plan anew for stored data; the history that is stored with them keeps its older part."""
        return self._write(tensordict, tensordict, advance=False)

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Add the written keys."""
        lead, device = observation_spec.shape, observation_spec.device
        shapes: dict[NestedKey, tuple[int, ...]] = {
            self.path_length_key: (1,),
            self.subgoal_key: (2,),
            self.subgoal_past_key: (len(self.lags), 2),
            self.history_key: (max(self.lags) + 1, 2),
        }
        if self.max_waypoints:
            shapes[self.path_key] = (self.max_waypoints, 2)
        for key, shape in shapes.items():
            observation_spec[key] = Unbounded(
                shape=(*lead, *shape), dtype=torch.float32, device=device
            )
        observation_spec[self.path_found_key] = Binary(
            shape=(*lead, 1), dtype=torch.bool, device=device
        )
        return observation_spec


def _fit(waypoints: Tensor, count: int) -> Tensor:
    """`[B, P, 2]` to `[B, count, 2]`: pad by the last point, or drop what comes before it."""
    padding = count - waypoints.shape[1]
    if padding >= 0:
        return torch.cat([waypoints, waypoints[:, -1:].expand(-1, padding, 2)], 1)
    return torch.cat([waypoints[:, : count - 1], waypoints[:, -1:]], 1)


def _check_numbers(
    mode: str, fraction: float, lookahead: float, lags: Sequence[int], max_waypoints: int
) -> None:
    if mode not in get_args(SubgoalMode):
        raise ValueError(
            f"PlannerSubgoals: mode must be one of {get_args(SubgoalMode)}, got {mode!r}."
        )
    if not 0 < fraction <= 1:
        raise ValueError(f"PlannerSubgoals: fraction must lie in (0, 1], got {fraction}.")
    if not lookahead > 0:
        raise ValueError(f"PlannerSubgoals: lookahead must be > 0 m, got {lookahead}.")
    if not lags or min(lags) < 0:
        raise ValueError(f"PlannerSubgoals: lags must be >= 0 and at least one, got {lags}.")
    if max_waypoints != 0 and max_waypoints < 2:
        raise ValueError(f"PlannerSubgoals: max_waypoints must be 0 or >= 2, got {max_waypoints}.")
