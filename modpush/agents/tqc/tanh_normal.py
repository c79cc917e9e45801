"""A draw from TorchRL's `TanhNormal` and its log-probability, as one differentiable operation.

Making the distribution, checking its arguments and building its graph takes three times as long as the
draw itself, and an update of actor and critics draws twice.
"""

import math
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import softplus

__all__ = ["tanh_normal_rsample"]

# Half of log(sqrt(2 pi)) + 2 log 2, from the normal density and from the squashing.
_CONSTANT = math.log(2) + 0.25 * math.log(2 * math.pi)


def tanh_normal_rsample(
    loc: Tensor, scale: Tensor, bounds: tuple[Tensor, Tensor] | None = None
) -> tuple[Tensor, Tensor]:
    """Draw actions and their log-probabilities, as `TanhNormal(loc, scale, ...).rsample_and_log_prob()`.

    The draw is the same for the same state of torch's random generator. Differentiable any number of
    times.

    Args:
        loc: Mean before the squashing, `[*B, A]`.
        scale: Standard deviation, the same shape, positive.
        bounds: Lowest and highest action, anything that broadcasts to `[*B, A]`; None for -1 and 1.

    Returns:
        Actions `[*B, A]` and their log-probabilities `[*B]`.
    """
    noise = torch.randn(loc.shape, dtype=loc.dtype, device=loc.device)
    action, log_prob = _TanhNormalSample.apply(loc, scale, noise)
    if bounds is not None:
        low, high = bounds
        half = (high - low) / 2
        action = action * half + (high + low) / 2
        log_prob = log_prob - half.log().expand(action.shape).sum(-1)
    return action, log_prob


class _TanhNormalSample(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, loc: Tensor, scale: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
        x = loc + noise * scale
        limit = 1 - torch.finfo(x.dtype).resolution  # TorchRL's: the inverse stays finite
        action = x.tanh().clamp_(-limit, limit)
        # log N(x) - log |d tanh(x) / dx|, the second in a form that does not overflow; the constants
        # of both taken off where the numbers are smallest.
        log_prob = -0.5 * noise**2 - scale.log() + 2 * (x + softplus(-2 * x) - _CONSTANT)
        ctx.save_for_backward(action, scale, noise)
        return action, log_prob.sum(-1)

    @staticmethod
    def backward(
        ctx: Any, grad_action: Tensor, grad_log_prob: Tensor
    ) -> tuple[Tensor, Tensor, None]:
        # Plain operations on an input and an output, so that this can be differentiated again.
        action, scale, noise = ctx.saved_tensors
        grad_log_prob = grad_log_prob.unsqueeze(-1)
        # The noise's own density stays as it is; the squashing's logarithm has slope -2 tanh(x).
        grad_loc = grad_action * (1 - action**2) + 2 * grad_log_prob * action
        return grad_loc, grad_loc * noise - grad_log_prob / scale, None
