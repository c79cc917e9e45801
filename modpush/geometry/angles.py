"""Angles and rotations in the plane."""

import torch
from torch import Tensor

from modpush._checks import check_real

__all__ = ["rotate", "wrap_angle"]


def wrap_angle(angle: Tensor) -> Tensor:
    """The same angle in [-pi, pi) [rad], for a real tensor of any shape.

    Raises:
        TypeError: If the angle is not a real tensor.
    """
    if not isinstance(angle, Tensor) or angle.is_complex():
        got = angle.dtype if isinstance(angle, Tensor) else type(angle).__name__
        raise TypeError(f"wrap_angle: angle must be a real tensor, got {got}.")
    return torch.remainder(angle + torch.pi, 2 * torch.pi) - torch.pi


def rotate(vectors: Tensor, angle: Tensor) -> Tensor:
    """Rotate vectors counter-clockwise.

    Args:
        vectors: `[..., 2]`.
        angle: `[..., 1]` [rad].

    Returns:
        `[..., 2]`.

    Raises:
        TypeError: If an argument is not a tensor.
        ValueError: If a last dimension differs from the expected one, or the others do not broadcast.
    """
    check_real("rotate", "vectors", vectors, 2)
    check_real("rotate", "angle", angle, 1)
    if angle.shape[:-1] != vectors.shape[:-1]:
        _check_broadcast(vectors, angle)
    cos, sin = angle.cos(), angle.sin()
    x, y = vectors[..., :1], vectors[..., 1:]
    return torch.cat([cos * x - sin * y, sin * x + cos * y], -1)


def _check_broadcast(vectors: Tensor, angle: Tensor) -> None:
    try:
        torch.broadcast_shapes(vectors.shape[:-1], angle.shape[:-1])
    except RuntimeError:
        raise ValueError(
            f"rotate: angle must be [..., 1] where vectors are [..., 2] = {list(vectors.shape)}, got "
            f"{list(angle.shape)}."
        ) from None
