"""Transforms from the depth image to sub-goals."""

from collections.abc import Mapping
from typing import Any

from tensordict import NestedKey
from torchrl.envs import Transform

from modpush.envs.scenes.scenario import ScenarioConfig
from modpush.planners.base import Planner
from modpush.planners.occupancy import OccupancyGrid
from modpush.planners.pose_field import PoseField
from modpush.planners.pose_subgoals import PoseSubgoals
from modpush.planners.subgoals import PlannerSubgoals
from modpush.planners.swept_obstacles import SweptObstacles
from modpush.recipes.config import PushEnvConfig

__all__ = ["TRUE", "make_planning"]

TRUE = "true"
"""Group of the plan from the true state, by which the reward goes where the policy observes another."""
_MAP_KEYS = {"occupancy": "occupancy", "blocked": "blocked_bits", "choice": "map_choice"}
_PLAN_KEYS = {
    "occupancy": "occupancy",
    "path_length": "path_length",
    "subgoal": "subgoal",
    "subgoal_past": "subgoal_past",
    "path_found": "path_found",
    "history": "subgoal_history",
    "path_ahead": "path_ahead",
}
_POSE_PLAN_KEYS = {
    "blocked": "blocked_bits",
    "path_length": "pose_path_length",
    "subgoal": "subgoal_pose",
    "path_found": "pose_path_found",
    "path_ahead": "pose_path_ahead",
}


def make_planning(
    config: PushEnvConfig,
    scenario: ScenarioConfig,
    planner: str | Planner | None,
    max_waypoints: int,
    read: Mapping[str, NestedKey],
    group: str | None = None,
) -> list[Transform]:
    """From depth image to sub-goals, which are written within a group if there is one."""
    # Where the config's distance from the workspace's edge leaves no way, the scenarios' own does: they
    # are drawn so that there is one.
    outside = config.planner_margin or 0.0
    margins = sorted({outside, max(outside, scenario.path_margin)})
    occupancy = OccupancyGrid(
        object_radius_key="object_radius",
        inscribed_radius_key="object_inscribed_radius",
        inflation=config.inflation,
        bounds=None if config.planner_margin is None else (scenario.low, scenario.high),
        margin=tuple(-margin for margin in margins),
        depth_key=read["depth"],
        segmentation_key=read["segmentation"],
        object_pose_key=read["object_pose"],
        **_within(group, _MAP_KEYS),
    )
    subgoals = PlannerSubgoals(
        config.planner if planner is None else planner,
        mode=config.subgoal_mode,
        fraction=config.subgoal_fraction,
        lookahead=config.subgoal_lookahead,
        lags=config.subgoal_lags,
        ahead=config.path_ahead,
        max_waypoints=max_waypoints,
        object_pose_key=read["object_pose"],
        **_within(group, _PLAN_KEYS),
    )
    maps: list[Transform] = [occupancy]
    if config.motion_ahead > 0:
        keys = {name: _MAP_KEYS[name] for name in ("occupancy", "blocked")}
        maps.append(SweptObstacles(config.motion_ahead, **_within(group, keys)))
    if not config.plan_poses:
        return [*maps, subgoals]
    poses = PoseSubgoals(
        PoseField(bounds=None if config.planner_margin is None else scenario.bounds(margins[-1])),
        ahead=config.path_ahead,
        symmetry_key=None if config.simulation.full_circle else "object_symmetry",
        object_pose_key=read["object_pose"],
        **_within(group, _POSE_PLAN_KEYS),
    )
    return [*maps, subgoals, poses]


def _within(group: str | None, keys: Mapping[str, str]) -> dict[str, Any]:
    """Arguments that put a transform's own keys into a group; none without a group."""
    return {} if group is None else {f"{own}_key": (group, name) for own, name in keys.items()}
