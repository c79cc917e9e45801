"""Checks of tensors at the border to compiled kernels, which check nothing themselves."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

__all__ = ["check_depth_unit", "check_dtype", "check_instance", "check_shape", "check_width"]

_STRIDE = 8  # of the pixels that are looked at first
_TOLERANCE = 1.1  # of the camera's height over the table


def check_dtype(who: str, name: str, value: Any, dtype: torch.dtype) -> None:
    """Check that a value is a torch tensor of a dtype.

    Args:
        who: What asks, for the error message.
        name: The argument's name.
        value: What was given.
        dtype: What is expected.

    Raises:
        TypeError: If it is something else, a NumPy array for instance.
    """
    if not isinstance(value, Tensor):
        raise TypeError(
            f"{who}: {name} must be a {dtype} tensor, got "
            f"{type(value).__module__}.{type(value).__name__}."
        )
    if value.dtype != dtype:
        raise TypeError(f"{who}: {name} must be a {dtype} tensor, got {value.dtype}.")


def check_shape(who: str, name: str, value: Tensor, letters: str, expected: Sequence[int]) -> None:
    """Check the shape of a tensor.

    Args:
        who: What asks, for the error message.
        name: The argument's name.
        value: What was given.
        letters: The expected dimensions in letters, `"B, H, W"`.
        expected: The expected dimensions in numbers.

    Raises:
        ValueError: If the shape is another one.
    """
    if value.shape != tuple(expected):
        raise ValueError(
            f"{who}: {name} must be [{letters}] = {list(expected)}, got {list(value.shape)}."
        )


def check_instance(who: str, name: str, value: Any, kind: type) -> None:
    """Check that a value is of a class.

    Args:
        who: What asks, for the error message.
        name: The argument's name.
        value: What was given.
        kind: The class.

    Raises:
        TypeError: If it is not.
    """
    if not isinstance(value, kind):
        raise TypeError(
            f"{who}: {name} must be of type {kind.__name__}, got {type(value).__name__}."
        )


def check_width(who: str, name: str, value: Any, width: int) -> None:
    """Check that a value is a real tensor or array `[..., width]`.

    Args:
        who: What asks, for the error message.
        name: The argument's name.
        value: What was given.
        width: The last dimension.

    Raises:
        TypeError: If it is something else.
        ValueError: If its last dimension is another one.
    """
    if not isinstance(value, Tensor | np.ndarray):
        raise TypeError(f"{who}: {name} must be a tensor, got {type(value).__name__}.")
    if value.ndim < 1 or value.shape[-1] != width:
        raise ValueError(f"{who}: {name} must be [..., {width}], got {list(value.shape)}.")


def check_depth_unit(who: str, depth: Tensor, camera_z: float) -> None:
    """Refuse depth in another unit than metres, which would read as an empty table.

    Args:
        who: What asks, for the error message.
        depth: `[B, H, W]` [m]; 0 where nothing was seen.
        camera_z: Height of the camera over the table [m].

    Raises:
        ValueError: If in one scene all pixels lie well beyond the table, or are not finite.
    """
    limit = _TOLERANCE * camera_z
    # NaN and infinity count as beyond. Few images get past the first, cheap look.
    if (
        depth.shape[0] == 0
        or (depth[:, ::_STRIDE, ::_STRIDE].abs() <= limit).flatten(1).any(1).all()
    ):
        return
    good = (depth.abs() <= limit).flatten(1).any(1)
    if not good.all():
        scene = int((~good).nonzero()[0, 0])
        raise ValueError(
            f"{who}: depth must be in metres along the optical axis of a camera {camera_z:g} m over "
            f"the table, got {depth[scene].min().item():g} to {depth[scene].max().item():g} in scene "
            f"{scene}: not one pixel shows the table or what stands on it."
        )
