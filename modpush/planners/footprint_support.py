"""Footprints by their extents in directions at equal angles."""

import math
from typing import Annotated

import numpy as np
import torch
from annotated_types import Ge
from numpy.typing import NDArray
from torch import Tensor

from modpush._arguments import checked_arguments
from modpush._checks import check_real

__all__ = ["extents_per_scene", "polygon_support"]


@checked_arguments
def polygon_support(corners: Tensor, directions: Annotated[int, Ge(3)] = 48) -> Tensor:
    """Extent of a polygon from the origin in directions at equal angles, the first along x.

    Args:
        corners: `[..., P, 2]` (x, y) in the object's frame, in any order [m]. A footprint that is not
            convex is given the extents of its hull.
        directions: Number of directions N. A side that faces none of them is moved outwards.

    Returns:
        `[..., N]` [m].

    Raises:
        TypeError: If `corners` is not a tensor of real numbers.
        ValueError: If its last dimension is not 2, or it has no corner.
    """
    check_real("corners", corners, 2)
    if corners.ndim < 2 or not corners.shape[-2]:
        raise ValueError(f"corners must be [..., P >= 1, 2], got {list(corners.shape)}.")
    angle = 2.0 * math.pi / directions * torch.arange(directions)
    axes = torch.stack([angle.cos(), angle.sin()]).to(corners)
    return (corners @ axes).amax(-2)


def extents_per_scene(support: Tensor, batch: int) -> NDArray[np.float64]:
    """Extents of the footprints, `[B, N]` float64, all positive and finite."""
    check_real("support", support)
    if support.ndim != 2 or len(support) != batch or support.shape[1] < 3:
        raise ValueError(
            f"support must be [B, N >= 3] with B = {batch}, got {list(support.shape)}."
        )
    extents = support.detach().double().cpu().numpy()
    good = np.isfinite(extents) & (extents > 0.0)
    if not good.all():
        scene = int((~good).any(1).nonzero()[0][0])
        raise ValueError(
            f"support must be positive and finite [m], got {extents[scene].min():g} to "
            f"{extents[scene].max():g} in scene {scene}."
        )
    return extents
