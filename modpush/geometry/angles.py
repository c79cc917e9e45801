"""Angles and rotations in the plane."""

import torch
from torch import Tensor

from modpush._checks import check_width

__all__ = ["rotate", "wrap_angle"]


def wrap_angle(angle: Tensor) -> Tensor:
    """The same angle in [-pi, pi) [rad], for a real tensor of any shape.

    Raises:
        TypeError: If it is none.
    """
    if not isinstance(angle, Tensor) or angle.is_complex():
        got = angle.dtype if isinstance(angle, Tensor) else type(angle).__name__
        raise TypeError(f"wrap_angle: angle must be a real tensor, got {got}.")
    return torch.remainder(angle + torch.pi, 2 * torch.pi) - torch.pi


def rotate(vectors: Tensor, angle: Tensor) -> Tensor:
    """Turn vectors counter-clockwise.

    Args:
        vectors: `[..., 2]`.
        angle: `[..., 1]` [rad].

    Returns:
        `[..., 2]`.

    Raises:
        TypeError: If one of them is no tensor.
        ValueError: If a last dimension is another one.
    """
    check_width("rotate", "vectors", vectors, 2)
    check_width("rotate", "angle", angle, 1)
    cos, sin = angle.cos(), angle.sin()
    x, y = vectors[..., :1], vectors[..., 1:]
    return torch.cat([cos * x - sin * y, sin * x + cos * y], -1)
