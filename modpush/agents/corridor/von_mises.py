"""What the corridor controller learns of an object: at which angle to stand to push it straight.

The angle alpha between "tool to object" and "object to target" at which a push went well is taken
to be von Mises distributed, VM(alpha; mu, kappa) = exp(kappa cos(alpha - mu)) / (2 pi I0(kappa)).

Source: Krivic and Piater, "Pushing corridors for delivering unknown objects with a mobile robot"
(Autonomous Robots 2019), in the form of the code that the paper compares with; the conjugate prior
of Guttorp and Lockhart (1988).
"""

import math

import torch
from torch import Tensor


def wrap_angle(angle: Tensor) -> Tensor:
    """The same angle in [-pi, pi) [rad]."""
    return torch.remainder(angle + math.pi, 2 * math.pi) - math.pi


def wrap_angle_faithful(angle: Tensor) -> Tensor:
    """The authors' wrapping, wrong outside (-pi, pi]: |a + 2 pi| below it, pi - a above it."""
    below, above = (angle + 2 * math.pi).abs(), math.pi - angle
    return torch.where(angle <= -math.pi, below, torch.where(angle > math.pi, above, angle))


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


def posterior(
    alphas: Tensor, valid: Tensor, strength: float, count: float, direction: float
) -> tuple[Tensor, Tensor]:
    """Most likely (mu, kappa) after angles were seen, by the conjugate update.

    The prior is p(mu, kappa) ~ exp(R0 kappa cos(phi - mu)) / I0(kappa)^c: as if c angles had been
    seen before whose unit vectors add up to length R0 in direction phi. Seen angles add theirs.

    Args:
        alphas: `[B, N]` [rad].
        valid: `[B, N]` bool, which of them count.
        strength: R0.
        count: c, > R0.
        direction: phi [rad].

    Returns:
        mu `[B]` [rad] and kappa `[B]`.
    """
    x = strength * math.cos(direction) + (alphas.cos() * valid).sum(-1)
    y = strength * math.sin(direction) + (alphas.sin() * valid).sum(-1)
    return torch.atan2(y, x), concentration(torch.hypot(x, y) / (count + valid.sum(-1)))


def posterior_faithful(
    alphas: Tensor, valid: Tensor, strength: float, direction: float
) -> tuple[Tensor, Tensor]:
    """The authors' (mu, kappa): a slip of precedence pins kappa to 50, the end of their grid.

    Their prior multiplies by I0(kappa)^c where it should divide; over their grid that outweighs
    any data. Mu is sought on whole degrees, with the mean of the seen angles' densities (not their
    product) as the likelihood.

    Args:
        alphas: `[B, N]` [rad].
        valid: `[B, N]` bool.
        strength: R0.
        direction: phi [rad].

    Returns:
        mu `[B]` in [0, 2 pi] [rad] and kappa `[B]`, 50.
    """
    kappa = 50.0
    mu = torch.linspace(0, 2 * math.pi, 361, dtype=alphas.dtype, device=alphas.device)
    density = (kappa * ((alphas[:, None] - mu[:, None]).cos() - 1)).exp() * valid[:, None]
    mean = density.sum(-1) / valid.sum(-1, keepdim=True).clamp_min(1)  # [B, 361]
    mean = torch.where(valid.any(-1, keepdim=True), mean, torch.ones_like(mean))
    score = mean.clamp_min(1e-300).log() + strength * kappa * (direction - mu).cos()
    best = mu[score.argmax(-1)]
    return best, torch.full_like(best, kappa)


def preferred_angle(
    alphas: Tensor, valid: Tensor, mu: Tensor, kappa: Tensor, circular: bool = True
) -> Tensor:
    """Mean of the seen angles, each weighted by its density; 0 before any was seen.

    Args:
        alphas: `[B, N]` [rad].
        valid: `[B, N]` bool.
        mu: `[B]` [rad].
        kappa: `[B]`.
        circular: Of the unit vectors, rather than of the numbers as in the authors' code.

    Returns:
        alpha_p `[B]` [rad].
    """
    weight = (kappa[:, None] * ((alphas - mu[:, None]).cos() - 1)).exp() * valid
    if circular:
        return torch.atan2((weight * alphas.sin()).sum(-1), (weight * alphas.cos()).sum(-1))
    total = weight.sum(-1)
    mean = (weight * alphas).sum(-1) / total.clamp_min(1e-300)
    return torch.where(total > 0, mean, torch.zeros_like(mean))


def activations(
    alpha: Tensor, alpha_p: Tensor, mu: Tensor, kappa: Tensor, faithful: bool = False
) -> tuple[Tensor, Tensor]:
    """How much to push and how much to go round the object.

    Args:
        alpha: `[B]` [rad], where the tool stands now; 0 is straight behind the object.
        alpha_p: `[B]` [rad], where it stood when pushing went well.
        mu: `[B]` [rad].
        kappa: `[B]`.
        faithful: Measure the way to alpha_p from mu, as the authors do. With their mu of nearly 0
            that makes no odds; with one that is learned it calls the best place to push a bad one.

    Returns:
        psi_push `[B]` in [0, 1], the density relative to its peak, and
        psi_relocate = sqrt(1 - psi_push^2).
    """
    apart = wrap_angle(alpha_p - alpha)
    near = (apart.abs() < math.pi / 8) & (apart.abs() < wrap_angle(alpha).abs())
    if faithful:
        deviation = torch.where(near, apart, alpha) - mu
    else:
        deviation = torch.where(near, apart, alpha - mu)
    push = (kappa * (deviation.cos() - 1)).exp()
    return push, (1 - push.square()).clamp_min(0).sqrt()
