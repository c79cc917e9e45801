"""`PoseSubgoals`: sub-goals with a yaw on the planned path of the object's pose."""

from collections.abc import Sequence
from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, TensorSpec

from modpush._checks import check_spec_has, read_key
from modpush._transforms import add_unbounded
from modpush._types import Positive, PositiveFraction
from modpush._validation import checked_arguments
from modpush.planners.pose_field import PoseField
from modpush.planners.pose_paths import poses_along
from modpush.planners.subgoals import PlanTransform


class PoseSubgoals(PlanTransform):
    """Plans from the object's pose to the goal pose and writes the path's length and a sub-goal.

    It reads the blocked cells of `OccupancyGrid`, which comes before it, as they are before inflation.
    The state between steps is in the tensordict: if there is no path, length, sub-goal and poses ahead
    of the step before are kept and `pose_path_found` is False; at a reset they are those of the
    straight way and the goal. For a start or goal that is not free see `PosePaths`. The yaws that are
    written are continuous from the object's, not wrapped.

    Args:
        planner: The planner; by default `PoseField()`. Its camera must be `OccupancyGrid`'s.
        fraction: The sub-goal lies at this fraction of the path's length, in (0, 1].
        ahead: Distances along the path of the poses that are written [m]. Empty for none.
        blocked_key: Read, `[..., H, 8 * ceil(W / 64)]` uint8, blocked cells as bits.
        object_pose_key: Read, `[..., 3]` (x, y, yaw) in the robot's base frame [m, rad].
        goal_pose_key: Read, `[..., 3]`, the same.
        support_key: Read, `[..., N]`, extents of the footprint, see `PoseField.plan` [m].
        symmetry_key: Read, `[..., 1]`, number of yaw angles at which the object looks the same, 0 for a
            disc. None: the goal's yaw is one of the full circle.
        path_length_key: Written and read back, `[..., 1]` float32, the path's cost: metres, and radians
            times the turning radius [m].
        subgoal_key: Written and read back, `[..., 3]` float32 in the robot's base frame [m, rad].
        path_found_key: Written, `[..., 1]` bool.
        path_ahead_key: Written and read back if `ahead` is given, `[..., len(ahead), 3]` float32 in the
            robot's base frame [m, rad].

    Raises:
        ValueError: If a number is out of range, or the planner is not a `PoseField`.
    """

    @checked_arguments
    def __init__(
        self,
        planner: PoseField | None = None,
        *,
        fraction: PositiveFraction = 0.2,
        ahead: Sequence[Positive] = (),
        blocked_key: NestedKey = "blocked_bits",
        object_pose_key: NestedKey = "object_pose",
        goal_pose_key: NestedKey = "goal_pose",
        support_key: NestedKey = "object_support",
        symmetry_key: NestedKey | None = "object_symmetry",
        path_length_key: NestedKey = "pose_path_length",
        subgoal_key: NestedKey = "subgoal_pose",
        path_found_key: NestedKey = "pose_path_found",
        path_ahead_key: NestedKey = "pose_path_ahead",
    ) -> None:
        in_keys = [blocked_key, object_pose_key, goal_pose_key, support_key]
        if symmetry_key is not None:
            in_keys.append(symmetry_key)
        out_keys = [path_length_key, subgoal_key, path_found_key]
        if ahead:
            out_keys.append(path_ahead_key)
        super().__init__(in_keys=in_keys, out_keys=out_keys)
        self.planner = planner or PoseField()
        self.fraction = fraction
        self.ahead = tuple(ahead)
        self.blocked_key = blocked_key
        self.object_pose_key = object_pose_key
        self.goal_pose_key = goal_pose_key
        self.support_key = support_key
        self.symmetry_key = symmetry_key
        self.path_length_key = self._memory = path_length_key
        self.subgoal_key = subgoal_key
        self.path_found_key = path_found_key
        self.path_ahead_key = path_ahead_key

    def describe(self) -> dict[str, Any]:
        """The planner's settings, and which poses of the path are written."""
        planner = self.planner
        return {
            "pose_subgoals": {
                "resolution": planner.resolution,
                "yaws": planner.yaws,
                "turning_radius": planner.turning_radius,
                "clearance": planner.clearance,
                "bounds": None if planner.bounds is None else [list(c) for c in planner.bounds],
                "full_circle": self.symmetry_key is None,
                "fraction": self.fraction,
                "ahead": list(self.ahead),
            }
        }

    def _symmetry(self, tensordict: TensorDictBase) -> float | Tensor:
        if self.symmetry_key is None:
            return 1.0
        return read_key(tensordict, self.symmetry_key, 1).reshape(-1)

    def _write(
        self, tensordict: TensorDictBase, before: TensorDictBase | None, advance: bool = False
    ) -> TensorDictBase:
        pose = read_key(tensordict, self.object_pose_key, 3)
        goal = read_key(tensordict, self.goal_pose_key, 3)
        blocked = read_key(tensordict, self.blocked_key)
        support = read_key(tensordict, self.support_key)
        lead, symmetry = pose.shape[:-1], self._symmetry(tensordict)
        support = support.reshape(-1, support.shape[-1])
        ends = pose.reshape(-1, 3), goal.reshape(-1, 3)
        paths = self.planner.plan(
            blocked.reshape(-1, *blocked.shape[-2:]), support, *ends, symmetry
        )
        found = paths.found.reshape(*lead, 1)
        length = paths.length.reshape(*lead, 1)
        distances = torch.where(paths.found, paths.length, 0.0)[:, None] * self.fraction
        poses = poses_along(paths, distances).reshape(*lead, 3)
        if before is None:
            straight = self.planner.straight_cost(support, *ends, symmetry)
            kept_length, kept_pose = straight.reshape(*lead, 1).to(length), goal.float()
        else:
            kept_length = read_key(before, self.path_length_key, 1)
            kept_pose = read_key(before, self.subgoal_key, 3)
        tensordict.set(self.path_length_key, torch.where(found, length, kept_length))
        tensordict.set(self.subgoal_key, torch.where(found, poses, kept_pose))
        tensordict.set(self.path_found_key, found)
        if self.ahead:
            points = poses_along(paths, self.ahead).reshape(*lead, len(self.ahead), 3)
            if before is None:
                kept = goal.float().unsqueeze(-2).expand_as(points)
            else:
                kept = read_key(before, self.path_ahead_key, len(self.ahead), 3)
            tensordict.set(self.path_ahead_key, torch.where(found.unsqueeze(-1), points, kept))
        return tensordict

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Add the written keys."""
        check_spec_has(observation_spec, self.in_keys)
        add_unbounded(observation_spec, self.path_length_key, 1)
        add_unbounded(observation_spec, self.subgoal_key, 3)
        if self.ahead:
            add_unbounded(observation_spec, self.path_ahead_key, len(self.ahead), 3)
        observation_spec[self.path_found_key] = Binary(
            shape=(*observation_spec.shape, 1), dtype=torch.bool, device=observation_spec.device
        )
        return observation_spec
