"""Angles and rotations in the plane."""

import torch
from torch import Tensor

__all__ = ["rotate", "wrap_angle"]


def wrap_angle(angle: Tensor) -> Tensor:
    """The same angle in [-pi, pi) [rad], for a real tensor of any shape."""
    return torch.remainder(angle + torch.pi, 2 * torch.pi) - torch.pi


def rotate(vectors: Tensor, angle: Tensor) -> Tensor:
    """Rotate vectors counter-clockwise.

    Args:
        vectors: `[..., 2]`.
        angle: `[..., 1]` [rad].

    Returns:
        `[..., 2]`.

    Raises:
        ValueError: If a last dimension differs from the expected one.
    """
    if vectors.shape[-1:] != (2,) or angle.shape[-1:] != (1,):
        raise ValueError(
            f"rotate: expected vectors [..., 2] and angle [..., 1], got {list(vectors.shape)} and "
            f"{list(angle.shape)}."
        )
    cos, sin = angle.cos(), angle.sin()
    x, y = vectors[..., :1], vectors[..., 1:]
    return torch.cat([cos * x - sin * y, sin * x + cos * y], -1)
