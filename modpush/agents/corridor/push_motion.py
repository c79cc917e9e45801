"""How the corridor controller moves the tool: push, go round, or back off."""

import math

import torch
from torch import Tensor

from modpush.agents.corridor.config import CorridorConfig


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


def face_way(way: Tensor, yaw: Tensor, max_turn: float) -> Tensor:
    """The rotation that turns the tool's wide side to the way of the push, the shorter way round.

    A flat face on the object steadies the push; a corner, or the narrow side, lets it slip. The
    tool looks the same turned by half a turn.

    Args:
        way: Direction of the push, `[B]` [rad].
        yaw: The tool's, `[B]` [rad]; at yaw 0 its wide side lies along x.
        max_turn: What a rotation of 1 turns it by [rad].

    Returns:
        `[B]` in [-1, 1].
    """
    twice = 2.0 * (way + math.pi / 2 - yaw)
    turn = torch.atan2(twice.sin(), twice.cos()) / 2.0
    return (turn / max_turn).clamp(-1.0, 1.0)
