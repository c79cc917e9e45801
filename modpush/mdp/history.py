"""Values of the last steps, newest first, and the one of a given age."""

import torch
from torch import Tensor

__all__ = ["of_age", "with_newest"]


def with_newest(value: Tensor, history: Tensor, lead: int) -> Tensor:
    """A value before those of earlier steps.

    Args:
        value: `[*B, *size]`.
        history: `[*B, n, *size]`, newest first.
        lead: Number of dimensions of `B`.

    Returns:
        `[*B, n + 1, *size]`.
    """
    return torch.cat([value.unsqueeze(lead), history], lead)


def of_age(values: Tensor, age: Tensor) -> Tensor:
    """The value of a given age in each scene.

    Args:
        values: `[*B, n, *size]`, newest first.
        age: `[*B, 1]` int64 in [0, n) [steps].

    Returns:
        `[*B, *size]`.
    """
    lead = age.ndim - 1
    flat = values.flatten(0, lead - 1) if lead > 1 else values
    chosen = flat[torch.arange(len(flat), device=age.device), age.reshape(-1)]
    return chosen.reshape(*age.shape[:-1], *values.shape[lead + 1 :])
