"""What differs between the controller with its mistakes mended and the authors' code as it is."""

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from modpush.agents.corridor import authors_code, von_mises
from modpush.agents.corridor.config import CorridorConfig
from modpush.geometry.angles import wrap_angle


class Rules(NamedTuple):
    """Steps of the controller that were mended; angles `[B]` [rad]."""

    wrap_angle: Callable[[Tensor], Tensor]
    """The same angle between -pi and pi."""
    fit_angles: Callable[[Tensor, Tensor, CorridorConfig], tuple[Tensor, Tensor]]
    """Fit of mu and kappa, each `[B]`, to the angles `[B, N]` of which those `[B, N]` count."""
    preferred_angle: Callable[[Tensor, Tensor, Tensor, Tensor], Tensor]
    """Mean of the angles `[B, N]` of which those `[B, N]` count, weighted with mu and kappa."""
    deviation: Callable[[Tensor, Tensor, Tensor, Tensor], Tensor]
    """Deviation of alpha from the best pushing angle, from (alpha, whether alpha_p is near, the angle
    from alpha to alpha_p, mu)."""
    deviation_terms: Callable[[Tensor], Tensor]
    """Summands of a deviation, of whose sum the mean is taken, `[B, 2]`."""
    mean_deviation: Callable[[Tensor, Tensor], Tensor]
    """Mean of the deviations, from the sum of their summands `[B, 2]` and their number `[B]`."""
    goes_round: Callable[[Tensor, float], Tensor]
    """Whether a psi_relocate `[B]` is enough to go around the object, `[B]` bool."""
    relative_zones: bool
    """Whether zones shrink for an object that is inside of them, see `Limits.relative`."""


MENDED = Rules(
    wrap_angle=wrap_angle,
    fit_angles=von_mises.fit_angles,
    preferred_angle=von_mises.preferred_angle,
    deviation=lambda alpha, near, apart, mu: torch.where(near, apart, alpha - mu),
    deviation_terms=lambda gamma: torch.stack([gamma.cos(), gamma.sin()], -1),
    mean_deviation=lambda total, count: torch.atan2(total[:, 1], total[:, 0]),
    goes_round=lambda relocate, threshold: relocate >= threshold,
    relative_zones=True,
)
"""The default: means of angles are means of directions, the posterior is the conjugate one."""

FAITHFUL = Rules(
    wrap_angle=authors_code.wrap_angle,
    fit_angles=authors_code.fit_angles,
    preferred_angle=authors_code.preferred_angle,
    # With the authors' mu of nearly 0, measuring the way to alpha_p from mu changes nothing; with
    # a mu that is learned it calls the best place to push a bad one.
    deviation=lambda alpha, near, apart, mu: torch.where(near, apart, alpha) - mu,
    deviation_terms=lambda gamma: torch.stack([torch.ones_like(gamma), gamma], -1),
    mean_deviation=lambda total, count: total[:, 1] / count.clamp_min(1),
    goes_round=lambda relocate, threshold: relocate > threshold,
    relative_zones=False,
)
"""The authors' code as it is."""

RULES = {"mended": MENDED, "faithful": FAITHFUL}
"""The rules by their name in `CorridorConfig.rules`."""
