"""Depth images of boxes at any pose, drawn by the same rays as `PushEnv`'s, and their windows."""

import math

import numpy as np
import torch
from torch import Tensor

from modpush.encoders import egocentric_window
from modpush.envs.depth.raycast import Solids, blank_image, draw
from modpush.geometry import Label
from modpush.geometry.shapes import box

Placed = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Size (length, width, height) [m] and pose (x, y, yaw)."""
CUBE = (0.05, 0.05, 0.05)


def image(obstacles: list[Placed], pushed: Placed | None = None) -> tuple[Tensor, Tensor]:
    """Depth `[1, H, W]` and segmentation of boxes standing on the table."""
    depth, labels = blank_image()
    groups = [(placed, Label.OBSTACLE) for placed in obstacles]
    if pushed is not None:
        groups.append((pushed, Label.OBJECT))
    for (size, (x, y, yaw)), label in groups:
        pose = [x, y, size[2] / 2, math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)]
        draw(depth, labels, Solids.of([box(*size)]), np.array([pose]), label)
    return torch.from_numpy(depth)[None], torch.from_numpy(labels)[None]


def moved(placed: Placed, shift: tuple[float, float], turn: float) -> Placed:
    """A box after the whole scene was turned about the base by `turn`, then shifted."""
    size, (x, y, yaw) = placed
    cos, sin = math.cos(turn), math.sin(turn)
    return size, (cos * x - sin * y + shift[0], sin * x + cos * y + shift[1], yaw + turn)


def window_of(obstacles: list[Placed], pushed: Placed, **options: object) -> Tensor:
    """The pushed object's window `[1, 1, 64, 64]`."""
    depth, labels = image(obstacles, pushed)
    pose = torch.tensor([pushed[1]])
    return egocentric_window(depth, labels, pose, **options)  # type: ignore[arg-type]
