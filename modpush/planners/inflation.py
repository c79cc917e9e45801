"""Inflation of blocked cells by a radius."""

from numbers import Real

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from modpush._checks import check_dtype
from modpush.planners.kernels.bit_grid import inflate_all
from modpush.planners.kernels.visibility import MAX_SIDE


def inflate(blocked: Tensor, radius: float | Tensor) -> Tensor:
    """Block every cell whose centre lies within a radius of a blocked cell's centre; exact.

    Args:
        blocked: `[B, H, W]` bool, H and W up to 4096.
        radius: One number, or `[B]` one per scene, finite and >= 0 [px].

    Returns:
        `[B, H, W]` bool.

    Raises:
        TypeError: If `blocked` is not a bool tensor.
        ValueError: If it is not `[B, H, W]`, or a radius is negative or not finite.
    """
    check_dtype("blocked", blocked, torch.bool)
    if blocked.ndim != 3 or not all(side <= MAX_SIDE for side in blocked.shape[1:]):
        raise ValueError(
            f"inflate: blocked must be [B, H, W] with H and W up to {MAX_SIDE}, got "
            f"{list(blocked.shape)}."
        )
    height, width = blocked.shape[1:]
    radii = clamp_radius(radius_per_scene(radius, len(blocked)), height, width)
    cells = blocked.detach().cpu().contiguous().view(torch.uint8)
    out = torch.empty_like(cells)
    inflate_all(len(cells), cells.numpy(), radii, out.numpy())
    return out.view(torch.bool).to(blocked.device)


def radius_per_scene(
    radius: float | Tensor, batch: int, name: str = "radius"
) -> NDArray[np.float64]:
    """One radius, or one for each scene, as `[B]` float64; errors name `name`.

    Raises:
        TypeError: If it is neither a number nor a tensor of real numbers.
        ValueError: If the number of radii is neither 1 nor B, or one is negative or not finite.
    """
    if isinstance(radius, Tensor):
        if radius.is_complex():
            raise TypeError(f"{name} must be real, got {radius.dtype}.")
        if radius.numel() not in (1, batch):
            raise ValueError(
                f"{name} must be one number or [B] = [{batch}], got {list(radius.shape)}."
            )
        values = radius.detach().double().cpu().reshape(-1).expand(batch).numpy().copy()
    elif isinstance(radius, Real) and not isinstance(radius, bool):
        values = np.full(batch, radius, dtype=np.float64)
    else:
        raise TypeError(f"{name} must be a number or a tensor, got {radius!r}.")
    if not (np.isfinite(values).all() and (values >= 0).all()):
        raise ValueError(f"{name} must be finite and >= 0, got {values.tolist()}.")
    return values


def clamp_radius(radius: NDArray[np.float64], height: int, width: int) -> NDArray[np.float64]:
    """Radii [px] limited to height plus width, beyond which the result does not change.

    No two cells are further apart, and the kernels' time grows with the radius.
    """
    return np.minimum(radius, float(height + width))
