"""What the corridor controller learns within an episode, and how it uses it.

All functions read the controller's state, see `state_spec`; `learn` updates it.
"""

import math
from typing import NamedTuple

import torch
from tensordict import TensorDict
from torch import Tensor

from modpush.agents.corridor.config import CorridorConfig
from modpush.agents.corridor.rules import Rules
from modpush.agents.corridor.scene import direction_of
from modpush.geometry.angles import wrap_angle


class Stance(NamedTuple):
    """How well the tool stands to push the object, `[B]` each."""

    alpha: Tensor
    """Angle between "tool to object" and "object to target" [rad]; 0 is straight behind it."""
    alpha_p: Tensor
    """The angle at which pushes went well [rad]."""
    push: Tensor
    """Activation psi_push in [0, 1]."""
    relocate: Tensor
    """Activation psi_relocate in [0, 1]."""


def activations(
    alpha: Tensor, alpha_p: Tensor, mu: Tensor, kappa: Tensor, rules: Rules
) -> tuple[Tensor, Tensor]:
    """How much to push and how much to go round the object.

    Args:
        alpha: Where the tool stands now, `[B]` [rad]; 0 is straight behind the object.
        alpha_p: Where it stood when pushes went well, `[B]` [rad].
        mu: `[B]` [rad].
        kappa: `[B]`.
        rules: How the deviation from the best place is measured.

    Returns:
        psi_push `[B]` in [0, 1], the density relative to its peak, and
        psi_relocate = sqrt(1 - psi_push^2).
    """
    apart = wrap_angle(alpha_p - alpha)
    near = (apart.abs() < math.pi / 8) & (apart.abs() < wrap_angle(alpha).abs())
    deviation = rules.deviation(alpha, near, apart, mu)
    push = (kappa * (deviation.cos() - 1)).exp()
    return push, (1 - push.square()).clamp_min(0).sqrt()


def judge_stance(state: TensorDict, alpha: Tensor, config: CorridorConfig, rules: Rules) -> Stance:
    """Compare where the tool stands, `alpha` of `Stance`, with where pushes went well."""
    noted = max(1, int(state["alpha_count"].max()))  # later places are empty in all scenes
    alphas = state["alphas"][:, :noted].double()
    valid = torch.arange(noted, device=alphas.device) < state["alpha_count"]
    mu, kappa = rules.fit_angles(alphas, valid, config)
    alpha_p = rules.preferred_angle(alphas, valid, mu, kappa)
    push, relocate = activations(alpha.double(), alpha_p, mu, kappa, rules)
    return Stance(alpha, alpha_p.float(), push.float(), relocate.float())


def learn(state: TensorDict, position: Tensor, config: CorridorConfig, rules: Rules) -> None:
    """Note how the object moved in the last step, and the angle if it moved straighter than before.

    The state is updated in place; `position` is the object's now, `[B, 2]` [m].
    """
    moved_by = position - state["object_position"]
    moved = (moved_by.norm(dim=-1) > config.moved_distance) & state["started"].squeeze(-1)
    wanted = state["target"] - state["object_position"]
    gamma = rules.wrap_angle(direction_of(moved_by) - direction_of(wanted))
    before, count = state["gamma"].squeeze(-1), state["gamma_count"].squeeze(-1)
    limit = before.abs().clamp_max(config.learnable_deviation)
    rows = (moved & (count > 0) & (gamma.abs() < limit)).nonzero().squeeze(-1)
    slot = state["alpha_count"].squeeze(-1).long().clamp_max(config.max_angles - 1)
    state["alphas"][rows, slot[rows]] = state["alpha"][rows, 0]
    state["alpha_count"][rows] += 1
    state["alpha_count"].clamp_(max=config.max_angles)
    rows = moved.nonzero().squeeze(-1)
    state["gamma"][rows, 0] = gamma[rows]
    state["gamma_count"][rows] += 1
    state["gamma_sum"][rows] += rules.deviation_terms(gamma)[rows]


def correction(state: TensorDict, config: CorridorConfig, rules: Rules) -> Tensor:
    """The angle to steer against, `[B]` [rad]."""
    mean = rules.mean_deviation(state["gamma_sum"], state["gamma_count"].squeeze(-1))
    last = state["gamma"].squeeze(-1)
    return config.mean_gain * mean + config.last_gain * last
