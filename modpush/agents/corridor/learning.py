"""Learning within an episode: the angle at which the tool pushes the object straight.

The angle alpha between "tool to object" and "object to target" at successful pushes is modelled as von
Mises distributed, VM(alpha; mu, kappa) = exp(kappa cos(alpha - mu)) / (2 pi I0(kappa)). The data are in
the controller's state, see `state_spec`; `learn` updates it.

Source: Krivic and Piater, "Pushing corridors for delivering unknown objects with a mobile robot"
(Autonomous Robots 2019), as implemented by the paper's authors; the conjugate prior of Guttorp and
Lockhart (1988).
"""

import math
from typing import NamedTuple

import torch
from tensordict import TensorDict
from torch import Tensor

from modpush._kernels import sum_in_order
from modpush.agents.corridor import authors_code
from modpush.agents.corridor.config import CorridorConfig
from modpush.geometry.frames import direction_of, wrap_angle


class Stance(NamedTuple):
    """Position of the tool relative to the object and its evaluation, `[B]` each."""

    # Angle between "tool to object" and "object to target" [rad]; 0 is straight behind the object
    alpha: Tensor
    alpha_p: Tensor  # Preferred angle: mean of the angles of successful pushes [rad]
    push: Tensor  # Activation psi_push in [0, 1]
    relocate: Tensor  # Activation psi_relocate in [0, 1]


def bessel_ratio(kappa: Tensor) -> Tensor:
    """I1(kappa) / I0(kappa), the length of the mean of VM(0, kappa)'s unit vectors."""
    return torch.special.i1e(kappa) / torch.special.i0e(kappa)


def concentration(ratio: Tensor) -> Tensor:
    """The kappa >= 0 of a given `bessel_ratio`, to a relative 1e-6 in float64.

    Ratios are clamped to [0, 1 - 1e-6]; at the upper end kappa is 5e5.
    """
    ratio = ratio.clamp(0.0, 1.0 - 1e-6)
    kappa = ratio * (2.0 - ratio.square()) / (1.0 - ratio.square())
    for _ in range(8):  # Newton: A' = 1 - A / kappa - A^2
        value = bessel_ratio(kappa)
        slope = 1.0 - value / kappa.clamp_min(1e-12) - value.square()
        step = (value - ratio) / slope.clamp_min(1e-12)
        kappa = torch.where(kappa > 1e-9, (kappa - step).clamp_min(0.0), kappa)
    return kappa


def fit_angles(alphas: Tensor, valid: Tensor, config: CorridorConfig) -> tuple[Tensor, Tensor]:
    """Posterior mode (mu, kappa), `[B]` each, of the angles `[B, N]` [rad] that are `valid`.

    The conjugate prior is p(mu, kappa) ~ exp(R0 kappa cos(phi - mu)) / I0(kappa)^c: c
    pseudo-observations whose unit vectors add up to length R0 in direction phi, see `CorridorConfig`.
    """
    strength, direction = config.prior_strength, config.prior_direction
    x = strength * math.cos(direction) + sum_in_order(alphas.cos() * valid)
    y = strength * math.sin(direction) + sum_in_order(alphas.sin() * valid)
    count = config.prior_count + valid.sum(-1)
    return torch.atan2(y, x), concentration(torch.hypot(x, y) / count)


def preferred_angle(alphas: Tensor, valid: Tensor, mu: Tensor, kappa: Tensor) -> Tensor:
    """Mean direction alpha_p of the valid angles, weighted by their density, `[B]` [rad].

    It is 0 without a valid angle. `alphas` [rad] and `valid` are `[B, N]`, `mu` [rad] and `kappa` `[B]`.
    """
    weight = (kappa[:, None] * ((alphas - mu[:, None]).cos() - 1)).exp() * valid
    return torch.atan2(sum_in_order(weight * alphas.sin()), sum_in_order(weight * alphas.cos()))


def activations(
    alpha: Tensor, alpha_p: Tensor, mu: Tensor, kappa: Tensor, faithful: bool = False
) -> tuple[Tensor, Tensor]:
    """Activations of pushing and of going around the object, `[B]` in [0, 1] each.

    psi_push is the density of the tool's angle alpha [rad], 0 straight behind the object, relative to
    its peak, and psi_relocate = sqrt(1 - psi_push^2). `faithful` measures the deviation as the authors'
    code does.
    """
    difference = wrap_angle(alpha_p - alpha)
    near = (difference.abs() < math.pi / 8) & (difference.abs() < wrap_angle(alpha).abs())
    if faithful:
        # With the authors' mu of nearly 0 it makes no difference that the angle to alpha_p is measured
        # from mu; with a mu that is learned the best angle would count as a bad one.
        deviation = torch.where(near, difference, alpha) - mu
    else:
        deviation = torch.where(near, difference, alpha - mu)
    push = (kappa * (deviation.cos() - 1)).exp()
    return push, (1 - push.square()).clamp_min(0).sqrt()


def judge_stance(state: TensorDict, alpha: Tensor, config: CorridorConfig) -> Stance:
    """Compare the tool's present angle alpha, `[B]` [rad], with the angles of successful pushes."""
    faithful = config.rules == "faithful"
    model = (authors_code.fit_angles, authors_code.preferred_angle)
    fit, prefer = model if faithful else (fit_angles, preferred_angle)
    used = max(
        1, int(state["alpha_count"].max())
    )  # the columns after these are empty in all scenes
    alphas = state["alphas"][:, :used].double()
    valid = torch.arange(used, device=alphas.device) < state["alpha_count"]
    mu, kappa = fit(alphas, valid, config)
    alpha_p = prefer(alphas, valid, mu, kappa)
    push, relocate = activations(alpha.double(), alpha_p, mu, kappa, faithful)
    return Stance(alpha, alpha_p.float(), push.float(), relocate.float())


def heading_difference(vector: Tensor, reference: Tensor, config: CorridorConfig) -> Tensor:
    """Angle from the heading of `reference` to that of `vector`, `[B, 2]` each, `[B]` [rad]."""
    difference = direction_of(vector) - direction_of(reference)
    wrap = authors_code.wrap_angle if config.rules == "faithful" else wrap_angle
    return wrap(difference)


def learn(state: TensorDict, position: Tensor, config: CorridorConfig) -> None:
    """Add the object's deviation in the last step to the state, and the angle of a successful push.

    A push is successful if the object moved straighter than in the step before. The state is updated
    in place; `position` is the object's present one, `[B, 2]` [m].
    """
    motion = position - state["object_position"]
    moved = (motion.norm(dim=-1) > config.moved_distance) & state["started"].squeeze(-1)
    gamma = heading_difference(motion, state["target"] - state["object_position"], config)
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
    # The mean of angles is the direction of their summed unit vectors; the authors' that of numbers.
    faithful = config.rules == "faithful"
    terms = (torch.ones_like(gamma), gamma) if faithful else (gamma.cos(), gamma.sin())
    state["gamma_sum"][rows] += torch.stack(terms, -1)[rows]


def correction(state: TensorDict, config: CorridorConfig) -> Tensor:
    """Angle by which the controller steers against the object's deviations, `[B]` [rad]."""
    x, y = state["gamma_sum"].unbind(-1)
    faithful = config.rules == "faithful"
    mean = y / state["gamma_count"].squeeze(-1).clamp_min(1) if faithful else torch.atan2(y, x)
    return config.mean_gain * mean + config.last_gain * state["gamma"].squeeze(-1)
