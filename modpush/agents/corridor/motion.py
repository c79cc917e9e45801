"""Direction of the tool's motion: it pushes, goes around the object, or backs off."""

import math

import numpy as np
import torch
from tensordict import TensorDict
from torch import Tensor

from modpush.agents.corridor.config import CorridorConfig
from modpush.agents.corridor.learning import Stance
from modpush.agents.corridor.scene import CorridorScene, object_clearance, tool_repulsion, unit
from modpush.planners import Planner, point_along

REST_TOOL, REST_OBJECT = 0.004, 0.002
"""Distances below which tool and object count as not moved in a step [m]."""
REPULSION_GAIN = 2.0
"""Weight of the repulsion from obstacles relative to a velocity of length 1."""
STEP = 0.02
"""Distance of the tool's next position along its planned path [m]."""
MARGIN = 0.005
"""Distance of the end of the tool's path from the circle around the object that it avoids [m]."""


def push_velocity(
    scene: CorridorScene, stance: Stance, has_moved: Tensor, config: CorridorConfig
) -> Tensor:
    """Velocity of order 1 of a tool that pushes the object or goes around it on a circle, `[B, 2]`.

    `has_moved` marks objects that have moved in this episode, `[B]` bool.
    """
    from_tool = scene.object_position - scene.tool_position
    forward = unit(from_tool)
    aside = torch.stack([forward[..., 1], -forward[..., 0]], -1)  # turned by -90 degrees
    side = torch.where(torch.sin(stance.alpha_p - stance.alpha) < 0, -1.0, 1.0)
    aside = aside * side.to(aside)[..., None]
    far_gain = torch.full_like(stance.push, config.approach_gain)
    # A tool that has lost contact returns while it circles, with speed `stance.push`; the first approach
    # is straight.
    far_gain = torch.where(has_moved, stance.push, far_gain)
    near = from_tool.norm(dim=-1) < scene.object_radius + config.near_distance
    gain = torch.where(near, -config.retreat_gain * stance.relocate, far_gain)
    if config.rules == "faithful":
        relocates = stance.relocate > config.inversion
    else:
        relocates = stance.relocate >= config.inversion
    gain = torch.where(relocates, gain, stance.push)
    return gain[..., None] * forward + stance.relocate[..., None] * aside


def follow_tool_path(
    scene: CorridorScene,
    velocity: Tensor,
    target: Tensor,
    relocate: Tensor,
    config: CorridorConfig,
    planner: Planner,
) -> Tensor:
    """Velocity `[B, 2]` along a planned path instead of the circle where obstacles are close.

    `target` is the object's, `[B, 2]` [m], and `relocate` the activation psi_relocate, `[B]`.
    """
    tight = object_clearance(scene) < config.navigate_distance
    rows = (tight & (relocate >= config.inversion)).nonzero().squeeze(-1)
    if not len(rows):
        return velocity
    ahead = next_tool_position(scene.select(rows), target[rows], config, planner)
    velocity = velocity.clone()
    velocity[rows] = ahead - scene.tool_position[rows]
    return velocity


def next_tool_position(
    scene: CorridorScene, target: Tensor, config: CorridorConfig, planner: Planner
) -> Tensor:
    """Next point of the tool's path to the position behind the object, `[B, 2]` (x, y) [m].

    The path keeps `near_distance` from the object's circumscribed circle and `tool_clearance` from
    obstacles. Where there is none, the point is the position behind the object. `target` is the
    object's, `[B, 2]` [m]. The authors' code plans no such path: their rod may graze obstacles.
    """
    camera, cell = scene.camera, scene.camera.cell_size
    keep_off = scene.object_radius + config.near_distance
    back = unit(scene.object_position - target)
    goal = camera.project(scene.object_position + (keep_off[:, None] + MARGIN) * back)
    start = camera.project(scene.tool_position)
    centre = camera.project(scene.object_position).numpy()
    v, u = np.ogrid[: camera.height, : camera.width]
    blocked = np.empty((len(start), camera.height, camera.width), dtype=bool)
    for b, distance in enumerate(scene.obstacle_distance):
        from_object = (u - centre[b, 0]) ** 2 + (v - centre[b, 1]) ** 2
        blocked[b] = distance <= config.tool_clearance / cell
        blocked[b] |= from_object <= (float(keep_off[b]) / cell) ** 2
    paths = planner.plan(torch.from_numpy(blocked), start, goal)
    steps = paths.waypoints.new_full((len(start),), STEP / cell)
    ahead = point_along(paths.waypoints, steps)
    return camera.unproject(torch.where(paths.found[:, None], ahead, goal))


def keep_off_obstacles(
    scene: CorridorScene,
    velocity: Tensor,
    relocate: Tensor,
    state: TensorDict,
    config: CorridorConfig,
) -> Tensor:
    """Velocity `[B, 2]` with repulsion from obstacles; a tool without motion backs off.

    `still` and `escape` of the state are updated in place; `relocate` is the activation psi_relocate,
    `[B]`.
    """
    repulsion = REPULSION_GAIN * tool_repulsion(scene, config.avoid_distance)
    velocity = unit(velocity) + relocate[:, None] * repulsion
    if not config.patience:
        return velocity
    rest = (scene.tool_position - state["tool_position"]).norm(dim=-1) < REST_TOOL
    rest &= (scene.object_position - state["object_position"]).norm(dim=-1) < REST_OBJECT
    rest &= state["started"].squeeze(-1) & (state["escape"].squeeze(-1) == 0)
    still = torch.where(rest, state["still"].squeeze(-1) + 1, 0.0)
    begins = still >= config.patience
    escape = (state["escape"].squeeze(-1) - 1).clamp_min(0)
    escape = torch.where(begins, float(config.escape_steps), escape)
    state["still"] = torch.where(begins, 0.0, still)[:, None]
    state["escape"] = escape[:, None]
    backwards = unit(scene.tool_position - scene.object_position) + repulsion
    return torch.where((escape > 0)[:, None], backwards, velocity)


def turn_wide_side(heading: Tensor, yaw: Tensor, max_turn: float) -> Tensor:
    """Rotation `[B]` in [-1, 1] that turns the tool's wide side towards the push, the shorter way.

    A flat face steadies the push; the object slips off a corner or the narrow side. The tool is
    symmetric under half a turn. At yaw 0 its wide side lies along x; a rotation of 1 is `max_turn`
    [rad].
    """
    # Not by `wrap_angle`, which rounds differently: episodes would not be those of the published tables.
    twice = 2.0 * (heading + math.pi / 2 - yaw)
    turn = torch.atan2(twice.sin(), twice.cos()) / 2.0
    return (turn / max_turn).clamp(-1.0, 1.0)
