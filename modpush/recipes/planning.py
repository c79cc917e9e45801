"""Transforms of delays, noise and planning, and the keys of what a policy observes with them."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from tensordict import NestedKey
from torchrl.envs import Transform

from modpush.envs.scenes.conditions import SensingConfig
from modpush.envs.scenes.scenario import ScenarioConfig
from modpush.geometry.frames import Frame
from modpush.geometry.workspace import Rectangle
from modpush.mdp.delays import ActionDelay, ObservationDelay
from modpush.mdp.noise import PoseNoise
from modpush.mdp.observation_inputs import ObservationKeys
from modpush.mdp.push_history import PushHistory
from modpush.mdp.stuck_recovery import StuckRecovery
from modpush.planners.grid_planner import Planner
from modpush.planners.occupancy import OccupancyGrid
from modpush.planners.pose_field import PoseField
from modpush.planners.pose_subgoals import PoseSubgoals
from modpush.planners.subgoals import PlannerSubgoals
from modpush.planners.swept_obstacles import SweptObstacles
from modpush.planners.through_obstacles import ThroughObstacles
from modpush.recipes.config import PushEnvConfig

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
        clearance=config.planner_clearance,
        bounds=None if config.planner_margin is None else (scenario.low, scenario.high),
        margin=tuple(-margin for margin in margins),
        depth_key=read["depth"],
        segmentation_key=read["segmentation"],
        object_pose_key=read["object_pose"],
        **_within(group, _MAP_KEYS),
    )
    if planner is None:
        # It crosses blocked cells, and so has to be told where the workspace ends.
        through = config.planner == "through_obstacles"
        bounds = Rectangle(scenario.low, scenario.high)
        planner = ThroughObstacles(bounds=bounds) if through else config.planner
    subgoals = PlannerSubgoals(
        planner,
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
        area = scenario.bounds(0.0)
        maps.append(SweptObstacles(config.motion_ahead, patrol_area=area, **_within(group, keys)))
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


_MEASURED = (
    "object_pose",
    "ee_pose",
    "joint_position",
    "object_contact",
    "depth",
    "segmentation",
)
_PATIENCE = 4  # of `StuckRecovery`


def observed_keys(sensing: SensingConfig) -> Mapping[str, NestedKey]:
    """Key of each measurement by its own name, `("observed", name)` where it differs from the truth."""
    delayed = sensing.observation_delay[1] > 0
    changed = _MEASURED if delayed else ("object_pose",) if sensing.noisy else ()
    return {name: ("observed", name) if name in changed else name for name in _MEASURED}


def observation_keys(observed: Mapping[str, NestedKey], *, mirrored: bool) -> ObservationKeys:
    """Keys that the entries of the observation read."""
    poses = {name: observed[name] for name in _MEASURED if name not in ("depth", "segmentation")}
    return ObservationKeys(latent="mirrored_latent" if mirrored else "latent", **poses)


def make_sensing(sensing: SensingConfig) -> list[Transform]:
    """Transforms next to `PushEnv`: a pose is measured with its noise, and arrives later."""
    transforms: list[Transform] = []
    if sensing.action_delay[1] > 0:
        transforms.append(ActionDelay(sensing.action_delay))
    if sensing.noisy:
        transforms.append(PoseNoise(sensing.position_noise, sensing.yaw_noise))
    if sensing.observation_delay[1] > 0:
        measured = observed_keys(replace(sensing, observation_delay=(0, 0)))
        delay = ObservationDelay(
            sensing.observation_delay,
            in_keys=[*measured.values()],
            out_keys=[*observed_keys(sensing).values()],
        )
        transforms.append(delay)
    return transforms


def make_history(frame: Frame, observed: Mapping[str, NestedKey]) -> PushHistory:
    """`PushHistory` of what is observed, for actions in these axes."""
    measured = ("object_pose", "ee_pose", "object_contact")
    return PushHistory(frame, **{f"{name}_key": observed[name] for name in measured})


def make_recovery(sensing: SensingConfig) -> StuckRecovery:
    """`StuckRecovery` of what is observed, which waits longer by the largest delays."""
    keys = observed_keys(sensing)
    return StuckRecovery(
        _PATIENCE + sensing.action_delay[1] + sensing.observation_delay[1],
        object_pose_key=keys["object_pose"],
        ee_pose_key=keys["ee_pose"],
    )
