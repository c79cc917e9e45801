"""The path of the object: as short as possible, in the middle of a corridor between obstacles.

Source: Krivic and Piater (2019), as implemented by the paper's authors: increased costs around obstacles.
"""

from typing import Literal

import numpy as np
import torch
from torch import Tensor

from modpush._batching import sum_in_order
from modpush.agents.corridor.config import CorridorConfig
from modpush.agents.corridor.scene import CorridorScene
from modpush.planners import AStar, point_along
from modpush.planners.occupancy import cells_outside


def corridor_cost(
    distance: Tensor, inner: Tensor, outer: Tensor, costs: tuple[float, float, float]
) -> Tensor:
    """Cost of each cell by its distance to obstacles, `[B, H, W]` float32.

    Args:
        distance: `[B, H, W]` [cells].
        inner: Width of the inner zone, `[B]` [cells].
        outer: Width of the outer zone, `[B]` [cells].
        costs: Cost of a cell that is free, in the outer zone, and in the inner zone.
    """
    inner, outer = inner[:, None, None], outer[:, None, None]
    cost = torch.full_like(distance, costs[0])
    cost[distance <= outer] = costs[1]
    cost[distance <= inner] = costs[2]
    return cost


def least_cost_path(
    distance: Tensor,
    cost: Tensor,
    ends: tuple[Tensor, Tensor],
    points: int,
    neighbours: Literal[4, 8] = 8,
) -> Tensor:
    """Path of least cost as equidistant points, `[B, points, 2]` (u, v) [px].

    Where there is no path, it is the straight line.

    Args:
        distance: Distance to obstacles, `[B, H, W]` [cells]; 0 on obstacles.
        cost: `[B, H, W]` float32.
        ends: Start and goal, each `[B, 2]` (u, v) [px].
        points: Number of points.
        neighbours: Number of neighbours of a cell, 4 or 8.
    """
    start, goal = ends
    paths = AStar(neighbours=neighbours).plan_weighted(distance == 0, cost, start, goal)
    straight = torch.stack([start, goal], 1)
    straight = torch.cat([straight, goal[:, None].expand(-1, paths.waypoints.shape[1] - 2, 2)], 1)
    line = torch.where(paths.found[:, None, None], paths.waypoints, straight)
    length = sum_in_order((line[:, 1:] - line[:, :-1]).norm(dim=-1))
    along = length[:, None] * torch.linspace(0.0, 1.0, points).to(length)  # [B, points]
    lines = line.repeat_interleave(points, 0)  # all points of all scenes at once
    return point_along(lines, along.flatten()).reshape(len(line), points, 2)


def plan_object_path(scene: CorridorScene, config: CorridorConfig) -> Tensor:
    """Path of the object to the goal, `[B, path_points, 2]` (x, y) [m]."""
    camera = scene.camera
    distance = torch.from_numpy(np.stack(scene.obstacle_distance))
    cells = scene.object_radius / camera.cell_size
    cost = corridor_cost(
        distance, config.inner_zone * cells, config.outer_zone * cells, config.zone_costs
    )
    if config.workspace is not None:
        outside = cells_outside(camera, config.workspace)
        cost = torch.where(outside, config.zone_costs[2], cost)
    ends = camera.project(scene.object_position), camera.project(scene.goal)
    path = least_cost_path(distance, cost, ends, config.path_points, config.neighbours)
    return camera.unproject(path)
