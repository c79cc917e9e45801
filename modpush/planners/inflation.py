"""Inflating blocked cells by the size of what has to pass."""

from numbers import Real

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from modpush._batching import run_batch
from modpush._checks import check_dtype
from modpush.planners.kernels.occupancy import inflate_few, inflate_many
from modpush.planners.kernels.visibility import MAX_SIDE

__all__ = [
    "circumscribed_radius",
    "clamp_radius",
    "inflate",
    "inscribed_radius",
    "radius_per_scene",
]


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
    check_dtype("inflate", "blocked", blocked, torch.bool)
    if blocked.ndim != 3 or not all(side <= MAX_SIDE for side in blocked.shape[1:]):
        raise ValueError(
            f"inflate: blocked must be [B, H, W] with H and W up to {MAX_SIDE}, got "
            f"{list(blocked.shape)}."
        )
    height, width = blocked.shape[1:]
    radii = clamp_radius(radius_per_scene(radius, len(blocked), "inflate"), height, width)
    cells = blocked.detach().cpu().contiguous().view(torch.uint8)
    out = torch.empty_like(cells)
    run_batch(inflate_few, inflate_many, len(cells), cells.numpy(), radii, out.numpy())
    return out.view(torch.bool).to(blocked.device)


def radius_per_scene(
    radius: float | Tensor, batch: int, who: str, name: str = "radius"
) -> NDArray[np.float64]:
    """A radius, or one for each scene, as `[B]` float64; errors name `who` and `name`.

    Raises:
        TypeError: If it is neither a number nor a tensor of real numbers.
        ValueError: If the number of radii is neither 1 nor B, or one is negative or not finite.
    """
    if isinstance(radius, Tensor):
        if radius.is_complex():
            raise TypeError(f"{who}: {name} must be real, got {radius.dtype}.")
        if radius.numel() not in (1, batch):
            raise ValueError(
                f"{who}: {name} must be one number or [B] = [{batch}], got {list(radius.shape)}."
            )
        values = radius.detach().double().cpu().reshape(-1).expand(batch).numpy().copy()
    elif isinstance(radius, Real) and not isinstance(radius, bool):
        values = np.full(batch, radius, dtype=np.float64)
    else:
        raise TypeError(f"{who}: {name} must be a number or a tensor, got {radius!r}.")
    if not (np.isfinite(values).all() and (values >= 0).all()):
        raise ValueError(f"{who}: {name} must be finite and >= 0, got {values.tolist()}.")
    return values


def clamp_radius(radius: NDArray[np.float64], height: int, width: int) -> NDArray[np.float64]:
    """Radii [px] no longer than height and width together, beyond which nothing changes.

    Every cell is nearer than that to every other one, and the kernels' time grows with the radius.
    """
    return np.minimum(radius, float(height + width))


def circumscribed_radius(outline: Tensor) -> float:
    """Radius of the smallest circle around the reference point that holds a whole footprint.

    Args:
        outline: `[N, 2]` corners of the footprint [m], relative to the object's pose.

    Raises:
        TypeError: If the outline is no tensor.
        ValueError: If it is not `[N, 2]`, N >= 1, or not finite.
    """
    _check_outline("circumscribed_radius", outline, 1)
    return float(outline.norm(dim=-1).max())


def inscribed_radius(outline: Tensor) -> float:
    """Radius of the largest circle around the reference point that a footprint holds.

    Args:
        outline: `[N, 2]` corners of a convex footprint [m] in order, relative to the object's pose,
            which lies inside.

    Raises:
        TypeError: If the outline is no tensor.
        ValueError: If it is not `[N, 2]`, N >= 3, not finite, or repeats a corner.
    """
    _check_outline("inscribed_radius", outline, 3)
    side = outline.roll(-1, 0) - outline  # [N, 2]
    if not (side.norm(dim=-1) > 0).all():
        raise ValueError(
            f"inscribed_radius: outline must not hold a corner twice in a row, got {outline.tolist()}."
        )
    area = outline[:, 0] * side[:, 1] - outline[:, 1] * side[:, 0]
    return float((area.abs() / side.norm(dim=-1)).min())


def _check_outline(who: str, outline: Tensor, least: int) -> None:
    if not isinstance(outline, Tensor) or not outline.is_floating_point():
        got = outline.dtype if isinstance(outline, Tensor) else type(outline).__name__
        raise TypeError(f"{who}: outline must be a floating point tensor, got {got}.")
    if outline.ndim != 2 or outline.shape[1] != 2 or len(outline) < least:
        raise ValueError(
            f"{who}: outline must be [N, 2] with N >= {least}, got {list(outline.shape)}."
        )
    if not outline.isfinite().all():
        raise ValueError(f"{who}: outline must be finite, got {outline.tolist()}.")
