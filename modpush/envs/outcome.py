"""Where an episode stands: at the goal, or out of bounds."""

from typing import Any, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from modpush.geometry.workspace import Rectangle

__all__ = ["GOAL_THRESHOLD", "is_at_goal", "is_out_of_bounds"]

GOAL_THRESHOLD = 0.05
"""An episode succeeds when the object's centre is this near to the goal [m]."""

Array = TypeVar("Array", NDArray[Any], Tensor)


def is_at_goal(position: Array, goal: Array, threshold: float = GOAL_THRESHOLD) -> Array:
    """Whether the object has reached its goal.

    Args:
        position: The object's centre, a numpy array or a tensor, `[B, 2]` [m].
        goal: The goal, of the same type, `[B, 2]` [m].
        threshold: Largest distance that counts as reached [m].

    Returns:
        `[B]` bool, of the same type.
    """
    x, y = (position - goal).T
    hypot = torch.hypot if isinstance(position, Tensor) else np.hypot
    return hypot(x, y) <= threshold


def is_out_of_bounds(position: Array, bounds: Rectangle) -> Array:
    """Whether the object has left the workspace by more than the margin of `bounds`.

    Args:
        position: The object's centre, a numpy array or a tensor, `[B, 2]` [m].
        bounds: Lower and upper corner, see `ScenarioConfig.bounds` [m].

    Returns:
        `[B]` bool, of the same type.
    """
    (low_x, low_y), (high_x, high_y) = bounds
    x, y = position.T
    return (x < low_x) | (x > high_x) | (y < low_y) | (y > high_y)
