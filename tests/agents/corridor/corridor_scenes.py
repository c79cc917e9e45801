"""Scenes for the tests of the corridor controller."""

import numpy as np
import torch

from modpush.agents.corridor.scene import (
    CorridorScene,
    corridor_cost,
    least_cost_path,
    obstacle_distance,
)


def wall(height=40, width=60, rows=slice(18, 22), columns=slice(0, 40)):
    """A wall from the left with a gap at its right."""
    blocked = np.zeros((height, width), bool)
    blocked[rows, columns] = True
    return blocked


def scene(distance, camera, object_position=(0.0, 0.0), tool_position=(0.0, 0.0), radius=0.0):
    return CorridorScene(
        camera=camera,
        obstacle_distance=distance,
        object_position=torch.as_tensor(object_position).reshape(-1, 2),
        object_radius=torch.full((len(distance),), radius),
        tool_position=torch.as_tensor(tool_position).reshape(-1, 2),
        tool_yaw=torch.zeros(len(distance)),
        goal=torch.zeros(len(distance), 2),
        touch_radius=torch.full((len(distance),), torch.inf),
    )


def plan(blocked, start, goal, inner=2.0, outer=5.0, points=64):
    distance = torch.from_numpy(obstacle_distance(blocked))[None]
    cost = corridor_cost(distance, torch.tensor([inner]), torch.tensor([outer]), (1.0, 50.0, 200.0))
    ends = torch.tensor([start], dtype=torch.float32), torch.tensor([goal], dtype=torch.float32)
    return least_cost_path(distance, cost, ends, points)[0].numpy()
