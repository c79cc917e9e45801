"""The model of what the controller learns: at which angle the tool pushes the object straight.

The angle alpha between "tool to object" and "object to target" at which a push went well is taken
to be von Mises distributed, VM(alpha; mu, kappa) = exp(kappa cos(alpha - mu)) / (2 pi I0(kappa)).

Source: Krivic and Piater, "Pushing corridors for delivering unknown objects with a mobile robot"
(Autonomous Robots 2019), in the form of the code that the paper compares with; the conjugate prior
of Guttorp and Lockhart (1988).
"""

import math

import torch
from torch import Tensor

from modpush._batching import sum_in_order
from modpush.agents.corridor.config import CorridorConfig


def bessel_ratio(kappa: Tensor) -> Tensor:
    """I1(kappa) / I0(kappa), the length of the mean of VM(0, kappa)'s unit vectors."""
    return torch.special.i1e(kappa) / torch.special.i0e(kappa)


def concentration(ratio: Tensor) -> Tensor:
    """The kappa >= 0 whose `bessel_ratio` is given.

    Args:
        ratio: In [0, 1); clamped to at most 1 - 1e-6, where kappa is 5e5.

    Returns:
        kappa, of the same shape, to a relative 1e-6 or so in float64.
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
    """Most likely (mu, kappa) after angles were observed, by the conjugate update.

    The prior is p(mu, kappa) ~ exp(R0 kappa cos(phi - mu)) / I0(kappa)^c: as if c angles had been
    observed before whose unit vectors add up to length R0 in direction phi. Observed angles add
    theirs.

    Args:
        alphas: `[B, N]` [rad].
        valid: Which of them count, `[B, N]` bool.
        config: The prior: R0 is `prior_strength`, c `prior_count` and phi `prior_direction`.

    Returns:
        mu `[B]` [rad] and kappa `[B]`.
    """
    strength, direction = config.prior_strength, config.prior_direction
    x = strength * math.cos(direction) + sum_in_order(alphas.cos() * valid)
    y = strength * math.sin(direction) + sum_in_order(alphas.sin() * valid)
    count = config.prior_count + valid.sum(-1)
    return torch.atan2(y, x), concentration(torch.hypot(x, y) / count)


def preferred_angle(alphas: Tensor, valid: Tensor, mu: Tensor, kappa: Tensor) -> Tensor:
    """Mean direction of the observed angles, each weighted by its density.

    Args:
        alphas: `[B, N]` [rad].
        valid: Which of them count, `[B, N]` bool.
        mu: `[B]` [rad].
        kappa: `[B]`.

    Returns:
        alpha_p `[B]` [rad], 0 where none counts.
    """
    weight = (kappa[:, None] * ((alphas - mu[:, None]).cos() - 1)).exp() * valid
    return torch.atan2(sum_in_order(weight * alphas.sin()), sum_in_order(weight * alphas.cos()))
