"""Checks of tensors at the border to compiled kernels, which check nothing themselves."""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

__all__ = ["check_dtype", "check_shape"]


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
