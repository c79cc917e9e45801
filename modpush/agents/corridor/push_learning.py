"""What the corridor controller learns within an episode, and how it acts upon it.

All functions read and write its state, see `state_spec`.
"""

import torch
from tensordict import TensorDict
from torch import Tensor

from modpush.agents.corridor.config import CorridorConfig
from modpush.agents.corridor.push_motion import direction_of
from modpush.agents.corridor.von_mises import (
    activations,
    posterior,
    posterior_faithful,
    preferred_angle,
    wrap_angle,
    wrap_angle_faithful,
)


def activate(
    state: TensorDict, alpha: Tensor, config: CorridorConfig
) -> tuple[Tensor, Tensor, Tensor]:
    """How much to push and to go round the object, and where it pays to stand.

    Args:
        state: Of B scenes.
        alpha: `[B]` [rad], see `activations`.
        config: Numbers.

    Returns:
        psi_push, psi_relocate and alpha_p [rad], each `[B]`.
    """
    alphas = state["alphas"].double()
    valid = torch.arange(config.window) < state["alpha_count"]
    if config.faithful:
        mu, kappa = posterior_faithful(alphas, valid, config.prior_strength, config.prior_direction)
    else:
        mu, kappa = posterior(
            alphas, valid, config.prior_strength, config.prior_count, config.prior_direction
        )
    alpha_p = preferred_angle(alphas, valid, mu, kappa, circular=not config.faithful)
    push, relocate = activations(alpha.double(), alpha_p, mu, kappa, config.faithful)
    return push.float(), relocate.float(), alpha_p.float()


def learn(state: TensorDict, position: Tensor, config: CorridorConfig) -> None:
    """Note how the object went, and the angle if it went straighter than before."""
    moved_by = position - state["object_position"]
    moved = (moved_by.norm(dim=-1) > config.moved) & state["started"].squeeze(-1)
    wanted = state["target"] - state["object_position"]
    wrap = wrap_angle_faithful if config.faithful else wrap_angle
    gamma = wrap(direction_of(moved_by) - direction_of(wanted))
    before, count = state["gamma"].squeeze(-1), state["gamma_count"].squeeze(-1)
    success = moved & (count > 0) & (gamma.abs() < before.abs().clamp_max(config.success))
    rows = success.nonzero().squeeze(-1)
    slot = state["alpha_count"].squeeze(-1).long().clamp_max(config.window - 1)
    state["alphas"][rows, slot[rows]] = state["alpha"][rows, 0]
    state["alpha_count"][rows] += 1
    state["alpha_count"].clamp_(max=config.window)
    rows = moved.nonzero().squeeze(-1)
    state["gamma"][rows, 0] = gamma[rows]
    state["gamma_count"][rows] += 1
    terms = torch.stack([gamma.cos(), gamma.sin()], -1)
    if config.faithful:
        terms = torch.stack([torch.ones_like(gamma), gamma], -1)  # numbers, not directions
    state["gamma_sum"][rows] += terms[rows]


def correction(state: TensorDict, config: CorridorConfig) -> Tensor:
    """What to steer against, `[B]` [rad]."""
    total, count = state["gamma_sum"], state["gamma_count"].squeeze(-1)
    if config.faithful:
        mean = total[:, 1] / count.clamp_min(1)
    else:
        mean = torch.atan2(total[:, 1], total[:, 0])
    last = state["gamma"].squeeze(-1)
    return config.mean_gain * mean + config.last_gain * last
