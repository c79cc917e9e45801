"""Clearance of points and segments from obstacles, and the direction that leads away from them."""

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from modpush._kernels import njit
from modpush.agents.corridor.scene import CorridorScene


@njit(nogil=True)
def least_clearance(distance: NDArray[Any], u0: float, v0: float, u1: float, v1: float) -> float:
    """Least distance to obstacles on a segment, sampled every half cell.

    Args:
        distance: Distance of each cell to obstacles, `[H, W]` float32 [cells].
        u0: Column of the segment's start [px].
        v0: Row of the segment's start [px].
        u1: Column of its end [px].
        v1: Row of its end [px].

    Returns:
        The distance [cells]; inf where the segment is off the grid.
    """
    steps = int(np.ceil(2.0 * max(abs(u1 - u0), abs(v1 - v0)))) + 1
    least = np.inf
    for k in range(steps + 1):
        i = int(np.rint(u0 + (u1 - u0) * k / steps))
        j = int(np.rint(v0 + (v1 - v0) * k / steps))
        if 0 <= i < distance.shape[1] and 0 <= j < distance.shape[0]:
            least = min(least, distance[j, i])
    return least


@njit(nogil=True)
def _clearance_at(distance: NDArray[Any], u: int, v: int) -> float:
    i = min(max(u, 0), distance.shape[1] - 1)
    j = min(max(v, 0), distance.shape[0] - 1)
    return distance[j, i]


@njit(nogil=True)
def away_from_obstacles(distance: NDArray[Any], u: float, v: float) -> tuple[float, float, float]:
    """The direction that leads away from the nearest obstacle.

    Args:
        distance: Distance of each cell to obstacles, `[H, W]` float32 [cells].
        u: Column [px].
        v: Row [px].

    Returns:
        A unit vector (u, v), zero where there is no obstacle, and the distance [cells].
    """
    i, j = int(np.rint(u)), int(np.rint(v))
    here = _clearance_at(distance, i, j)
    if not np.isfinite(here):
        return 0.0, 0.0, np.inf
    du = _clearance_at(distance, i + 2, j) - _clearance_at(distance, i - 2, j)
    dv = _clearance_at(distance, i, j + 2) - _clearance_at(distance, i, j - 2)
    length = np.sqrt(du * du + dv * dv)
    if length < 1e-6:
        return 0.0, 0.0, here
    return du / length, dv / length, here


def object_clearance(scene: CorridorScene) -> Tensor:
    """Distance of the object's centre to obstacles, `[B]` [m].

    Off the image it is the distance of the nearest cell of the image.
    """
    pixel = scene.camera.project(scene.object_position).round().int().tolist()
    cells = [
        _clearance_at(distance, u, v)
        for distance, (u, v) in zip(scene.obstacle_distance, pixel, strict=True)
    ]
    return torch.tensor(cells, dtype=scene.object_position.dtype) * scene.camera.cell_size


def tool_repulsion(scene: CorridorScene, reach: float) -> Tensor:
    """Vector that pushes the tool away from obstacles.

    Args:
        scene: `B` scenes.
        reach: Distance at which the length is 0 [m]; 0 for no repulsion at all.

    Returns:
        `[B, 2]`, of a length that grows from 0 at `reach` to 1 at contact.
    """
    pixel = scene.camera.project(scene.tool_position.double()).tolist()
    pushes = []
    for distance, (u, v) in zip(scene.obstacle_distance, pixel, strict=True):
        du, dv, cells = away_from_obstacles(distance, u, v)
        share = max(0.0, 1.0 - cells * scene.camera.cell_size / reach) if reach > 0 else 0.0
        pushes.append([-dv * share, -du * share])  # up in the image is +x, left is +y
    return torch.tensor(pushes, dtype=scene.tool_position.dtype).reshape(-1, 2)
