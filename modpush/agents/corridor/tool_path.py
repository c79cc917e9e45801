"""The planned path of the tool behind the object, past obstacles and the object itself.

The authors' code has none of this: their tool is a rod that may brush past anything.
"""

import numpy as np
import torch
from torch import Tensor

from modpush.agents.corridor.config import CorridorConfig
from modpush.agents.corridor.scene import CorridorScene, unit
from modpush.planners import Planner, point_along

STEP = 0.02
"""How far ahead on its path the tool aims [m]."""
MARGIN = 0.005
"""How far outside of the circle around the object, which the tool avoids, its path ends [m]."""


def next_tool_position(
    scene: CorridorScene, target: Tensor, config: CorridorConfig, planner: Planner
) -> Tensor:
    """The next point of the tool's path to the place behind the object.

    Args:
        scene: `B` scenes.
        target: Point that the object is to be pushed towards, `[B, 2]` [m].
        config: Settings; the tool's centre keeps `near_distance` from the object's circumscribed
            circle and `tool_clearance` from obstacles.
        planner: Plans the path.

    Returns:
        `[B, 2]` (x, y) [m]; the place behind the object where there is no path to it.
    """
    camera, cell = scene.camera, scene.camera.cell_size
    keep_off = scene.object_radius + config.near_distance
    back = unit(scene.object_position - target)
    goal = camera.project(scene.object_position + (keep_off[:, None] + MARGIN) * back)
    here, centre = (
        camera.project(scene.tool_position),
        camera.project(scene.object_position).numpy(),
    )
    v, u = np.ogrid[: camera.height, : camera.width]
    blocked = np.empty((len(here), camera.height, camera.width), dtype=bool)
    for b, distance in enumerate(scene.obstacle_distance):
        from_object = (u - centre[b, 0]) ** 2 + (v - centre[b, 1]) ** 2
        blocked[b] = (distance <= config.tool_clearance / cell) | (
            from_object <= (float(keep_off[b]) / cell) ** 2
        )
    paths = planner.plan(torch.from_numpy(blocked), here, goal)
    steps = paths.waypoints.new_full((len(here),), STEP / cell)
    ahead = point_along(paths.waypoints, steps)
    return camera.unproject(torch.where(paths.found[:, None], ahead, goal))
