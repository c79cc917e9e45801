"""Steps of the authors' code that `modpush` mends, kept as they are to compare with."""

import math

import torch
from torch import Tensor

from modpush._batching import sum_in_order
from modpush.agents.corridor.config import CorridorConfig


def wrap_angle(angle: Tensor) -> Tensor:
    """The authors' wrapping, wrong outside (-pi, pi]: |a + 2 pi| below it, pi - a above it."""
    below, above = (angle + 2 * math.pi).abs(), math.pi - angle
    return torch.where(angle <= -math.pi, below, torch.where(angle > math.pi, above, angle))


def fit_angles(alphas: Tensor, valid: Tensor, config: CorridorConfig) -> tuple[Tensor, Tensor]:
    """The authors' (mu, kappa): a slip of precedence pins kappa to 50, the end of their grid.

    Their prior multiplies by I0(kappa)^c where it should divide; over their grid that outweighs
    any data. Mu is sought on whole degrees, with the mean of the angles' densities (not their
    product) as the likelihood.

    Args:
        alphas: `[B, N]` [rad].
        valid: Which of them count, `[B, N]` bool.
        config: The prior.

    Returns:
        mu `[B]` in [0, 2 pi] [rad] and kappa `[B]`, 50.
    """
    kappa = 50.0
    mu = torch.linspace(0, 2 * math.pi, 361, dtype=alphas.dtype, device=alphas.device)
    density = (kappa * ((alphas[:, None] - mu[:, None]).cos() - 1)).exp() * valid[:, None]
    mean = sum_in_order(density) / valid.sum(-1, keepdim=True).clamp_min(1)  # [B, 361]
    mean = torch.where(valid.any(-1, keepdim=True), mean, torch.ones_like(mean))
    prior = config.prior_strength * kappa * (config.prior_direction - mu).cos()
    score = mean.clamp_min(1e-300).log() + prior
    best = mu[score.argmax(-1)]
    return best, torch.full_like(best, kappa)


def preferred_angle(alphas: Tensor, valid: Tensor, mu: Tensor, kappa: Tensor) -> Tensor:
    """The authors' weighted mean of angles, taken of the numbers and not of the directions.

    Args:
        alphas: `[B, N]` [rad].
        valid: Which of them count, `[B, N]` bool.
        mu: `[B]` [rad].
        kappa: `[B]`.

    Returns:
        alpha_p `[B]` [rad], 0 where none counts.
    """
    weight = (kappa[:, None] * ((alphas - mu[:, None]).cos() - 1)).exp() * valid
    total = sum_in_order(weight)
    mean = sum_in_order(weight * alphas) / total.clamp_min(1e-300)
    return torch.where(total > 0, mean, torch.zeros_like(mean))
