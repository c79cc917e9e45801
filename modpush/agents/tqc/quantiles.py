"""Operations on atoms: truncate the pooled targets, regress the quantiles towards them.

The pairwise quantile-Huber loss comes with its gradient in closed form. Autograd would keep several
`[N, B, n, m]` tensors alive and walk them again in the backward pass; value, gradient and mean
absolute error all follow from one look at each pair, so a single kernel makes them together and
the backward pass is one multiplication.
"""

from typing import Any

import numpy as np
import torch
from torch import Tensor

from modpush._checks import check_instance
from modpush._kernels import njit


def truncate_atoms(atoms: Tensor, num_dropped: int) -> Tensor:
    """Pool the atoms of all critics and drop the highest of the pool.

    Args:
        atoms: Atoms of `N` target critics, `[N, *B, n]`, constants.
        num_dropped: Number of the `N * n` pooled atoms to drop.

    Returns:
        The lowest atoms in ascending order, `[*B, N * n - num_dropped]`.

    Raises:
        TypeError: If the atoms are not a tensor, or `num_dropped` is not a whole number.
        ValueError: If no atom would be left, or `num_dropped` is negative.

    Source: Kuznetsov et al. (2020), eq. 9-10.
    """
    check_instance("atoms", atoms, Tensor)
    check_instance("num_dropped", num_dropped, int)
    if atoms.ndim < 2 or num_dropped < 0:
        raise ValueError(
            "truncate_atoms: atoms must be [N, *B, n] and num_dropped >= 0, got "
            f"{list(atoms.shape)} and {num_dropped}."
        )
    pooled = atoms.movedim(0, -2).flatten(-2)
    kept = pooled.shape[-1] - num_dropped
    if kept < 1:
        raise ValueError(
            f"truncate_atoms: num_dropped must be below the {pooled.shape[-1]} atoms held, "
            f"got {num_dropped}."
        )
    if _runs_native(pooled):
        # numpy's vectorised sort takes an eighth of torch's time on rows this short.
        return torch.from_numpy(np.sort(pooled.detach().numpy(), axis=-1)[..., :kept])
    return pooled.sort(dim=-1).values[..., :kept]


def quantile_huber(quantiles: Tensor, targets: Tensor) -> tuple[Tensor, Tensor]:
    """Quantile regression of every critic's atoms towards every target atom.

    Differentiable any number of times, with respect to `quantiles` only: targets are constants.

    Args:
        quantiles: Predicted atoms of `N` critics, `[N, *B, n]`, floating point.
        targets: Target atoms, `[*B, m]`, same dtype and device.

    Returns:
        The loss, a mean over all `n * m` pairs, `[N, *B]`, and the mean absolute difference over
        the pairs, `[N, *B]`, without gradient.

    Raises:
        TypeError: If one of them is not a tensor.
        ValueError: If the batch shapes or the dtypes differ.

    Source: Kuznetsov et al. (2020), eq. 12-13, with Huber threshold 1.
    """
    check_instance("quantiles", quantiles, Tensor)
    check_instance("targets", targets, Tensor)
    if quantiles.shape[1:-1] != targets.shape[:-1]:
        raise ValueError(
            f"quantile_huber: quantiles {tuple(quantiles.shape)} must be [N, *B, n] for targets "
            f"[*B, m], got targets {tuple(targets.shape)}."
        )
    if quantiles.dtype != targets.dtype:
        raise ValueError(
            f"quantile_huber: quantiles and targets must share a dtype, got {quantiles.dtype} "
            f"and {targets.dtype}."
        )
    return _QuantileHuber.apply(quantiles, targets)


class _QuantileHuber(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, quantiles: Tensor, targets: Tensor) -> tuple[Tensor, Tensor]:
        if _runs_native(quantiles):
            loss, gradient, error = _forward_numba(quantiles, targets)
        else:
            loss, gradient, error = _forward_torch(quantiles, targets)
        ctx.save_for_backward(gradient, quantiles, targets)
        ctx.mark_non_differentiable(error)
        return loss, error

    @staticmethod
    def backward(ctx: Any, grad_loss: Tensor, grad_error: Tensor) -> tuple[Tensor, None]:
        gradient, quantiles, targets = ctx.saved_tensors
        if torch.is_grad_enabled():  # create_graph=True: the gradient depends on the quantiles
            _, gradient, _ = _forward_torch(quantiles, targets.detach())
        return gradient * grad_loss.unsqueeze(-1), None


def _runs_native(x: Tensor) -> bool:
    """True if numpy and numba can work on this tensor's memory."""
    native = x.device.type == "cpu" and x.dtype in (torch.float32, torch.float64)
    return native and not torch.compiler.is_compiling()


def _forward_torch(quantiles: Tensor, targets: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Loss, gradient and mean absolute error in tensor operations, for any device and dtype."""
    num_quantiles = quantiles.shape[-1]
    fractions = torch.arange(num_quantiles, device=quantiles.device, dtype=quantiles.dtype)
    fractions = ((fractions + 0.5) / num_quantiles).unsqueeze(-1)
    delta = targets.unsqueeze(-2) - quantiles.unsqueeze(-1)  # [N, *B, n, m]
    slope = delta.clamp(-1, 1)  # the Huber function's derivative
    weighted_slope = (fractions - (delta < 0).to(delta.dtype)).abs() * slope
    # Huber(d) = s * (d - s / 2) with s = clip(d, -1, 1), in both of its branches.
    loss = (weighted_slope * (delta - 0.5 * slope)).mean(dim=(-2, -1))
    gradient = weighted_slope.sum(-1) / -(num_quantiles * targets.shape[-1])
    return loss, gradient, delta.abs().mean(dim=(-2, -1))


def _forward_numba(quantiles: Tensor, targets: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    num_critics, num_quantiles = quantiles.shape[0], quantiles.shape[-1]
    flat = quantiles.detach().reshape(num_critics, -1, num_quantiles).contiguous()
    flat_targets = targets.detach().reshape(-1, targets.shape[-1]).contiguous()
    gradient = torch.empty_like(flat)
    loss, error = flat.new_empty(2, num_critics, flat.shape[1])
    _kernel(flat.numpy(), flat_targets.numpy(), loss.numpy(), gradient.numpy(), error.numpy())
    shape = quantiles.shape[:-1]
    return loss.view(shape), gradient.view_as(quantiles), error.view(shape)


# Pairs a vector register takes at once (eight single-precision numbers in AVX2).
_LANES = 8


# Without leave to reorder the sums, LLVM does not vectorise the inner loop. NaN and infinity keep
# their meaning: only reassociation, contraction and the sign of zero are given up. One thread on
# purpose: the whole kernel takes well under a millisecond, and numba's worker pool neither forks
# nor nests inside other threads safely.
@njit(nogil=True, fastmath={"reassoc", "contract", "nsz"}, error_model="numpy")
def _kernel(quantiles: Any, targets: Any, loss: Any, gradient: Any, error: Any) -> None:
    num_critics, batch, num_quantiles = quantiles.shape
    num_targets = targets.shape[1]
    num_vectors = -(-num_targets // _LANES)
    dtype = quantiles.dtype.type
    zero, half, one = dtype(0), dtype(0.5), dtype(1)
    scale = one / dtype(num_quantiles * num_targets)
    target = np.empty(num_vectors * _LANES, quantiles.dtype)
    for critic in range(num_critics):
        for row in range(batch):
            target[:num_targets] = targets[row]
            row_loss, row_error = zero, zero
            for i in range(num_quantiles):
                quantile = quantiles[critic, row, i]
                # The tail of the last vector meets itself and adds nothing; it halves the time.
                for j in range(num_targets, num_vectors * _LANES):
                    target[j] = quantile
                above = (dtype(i) + half) / dtype(num_quantiles)
                below = one - above
                slope_sum, loss_sum, error_sum = zero, zero, zero
                for j in range(num_vectors * _LANES):
                    delta = target[j] - quantile
                    slope = min(max(delta, -one), one)
                    weighted_slope = (above if delta >= zero else below) * slope
                    slope_sum += weighted_slope
                    loss_sum += weighted_slope * (delta - half * slope)
                    error_sum += abs(delta)
                gradient[critic, row, i] = -slope_sum * scale
                row_loss += loss_sum
                row_error += error_sum
            loss[critic, row] = row_loss * scale
            error[critic, row] = row_error * scale
