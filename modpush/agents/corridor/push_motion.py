"""The direction in which the tool moves: it pushes, goes round the object, or backs off."""

import math

import torch
from tensordict import TensorDict
from torch import Tensor

from modpush.agents.corridor.clearance import object_clearance, tool_repulsion
from modpush.agents.corridor.config import CorridorConfig
from modpush.agents.corridor.push_learning import Stance
from modpush.agents.corridor.rules import Rules
from modpush.agents.corridor.scene import CorridorScene, unit
from modpush.agents.corridor.tool_path import next_tool_position
from modpush.planners import Planner

REST_TOOL, REST_OBJECT = 0.004, 0.002
"""Distances below which tool and object count as not moved in a step [m]."""
REPULSION_GAIN = 2.0
"""Weight of the repulsion from obstacles beside a velocity of length 1."""


def push_velocity(
    scene: CorridorScene, stance: Stance, has_moved: Tensor, config: CorridorConfig, rules: Rules
) -> Tensor:
    """Velocity of order 1 of the tool that pushes the object or goes round it on a circle, `[B, 2]`.

    `has_moved` says whether the object has moved before, `[B]` bool.
    """
    from_tool = scene.object_position - scene.tool_position
    forward = unit(from_tool)
    aside = torch.stack([forward[..., 1], -forward[..., 0]], -1)  # turned by -90 degrees
    side = torch.where(torch.sin(stance.alpha_p - stance.alpha) < 0, -1.0, 1.0)
    aside = aside * side.to(aside)[..., None]
    far_gain = torch.full_like(stance.push, config.approach_gain)
    # A tool that has touched the object and drifted off comes back while circling, but no faster
    # than the activations say; the first approach goes straight.
    far_gain = torch.where(has_moved, stance.push, far_gain)
    near = from_tool.norm(dim=-1) < scene.object_radius + config.near_distance
    gain = torch.where(near, -config.retreat_gain * stance.relocate, far_gain)
    goes_round = rules.goes_round(stance.relocate, config.inversion)
    gain = torch.where(goes_round, gain, stance.push)
    return gain[..., None] * forward + stance.relocate[..., None] * aside


def follow_tool_path(
    scene: CorridorScene,
    velocity: Tensor,
    target: Tensor,
    relocate: Tensor,
    config: CorridorConfig,
    planner: Planner,
) -> Tensor:
    """The velocity, `[B, 2]`, with a planned path instead of the circle where obstacles are close.

    The object is to be pushed towards `target`, `[B, 2]` [m]; `relocate` is the activation psi_relocate,
    `[B]`.
    """
    tight = object_clearance(scene) < config.navigate_distance
    rows = (tight & (relocate >= config.inversion)).nonzero().squeeze(-1)
    if not len(rows):
        return velocity
    ahead = next_tool_position(scene.select(rows), target[rows], config, planner)
    velocity = velocity.clone()
    velocity[rows] = ahead - scene.tool_position[rows]
    return velocity


def keep_off_obstacles(
    scene: CorridorScene,
    velocity: Tensor,
    relocate: Tensor,
    state: TensorDict,
    config: CorridorConfig,
) -> Tensor:
    """The velocity, `[B, 2]`, that keeps the tool off obstacles, and backs off where nothing moves.

    `still` and `escape` of the state are updated in place; `relocate` is the activation psi_relocate,
    `[B]`.
    """
    push_off = tool_repulsion(scene, config.avoid_distance)
    velocity = unit(velocity) + REPULSION_GAIN * relocate[:, None] * push_off
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
    backwards = unit(scene.tool_position - scene.object_position) + REPULSION_GAIN * push_off
    return torch.where((escape > 0)[:, None], backwards, velocity)


def turn_wide_side(heading: Tensor, yaw: Tensor, max_turn: float) -> Tensor:
    """The rotation that turns the tool's wide side towards the push, the shorter way round.

    A flat face on the object steadies the push; a corner, or the narrow side, lets it slip. The
    tool looks the same turned by half a turn.

    Args:
        heading: Direction of the push, `[B]` [rad].
        yaw: Orientation of the tool, `[B]` [rad]; at yaw 0 its wide side lies along x.
        max_turn: Angle by which a rotation of 1 turns it [rad].

    Returns:
        `[B]` in [-1, 1].
    """
    twice = 2.0 * (heading + math.pi / 2 - yaw)
    turn = torch.atan2(twice.sin(), twice.cos()) / 2.0
    return (turn / max_turn).clamp(-1.0, 1.0)
