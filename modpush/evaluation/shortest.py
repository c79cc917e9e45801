"""The shortest way of the object to its goal, the same yardstick for every method."""

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from modpush._validation import checked_arguments
from modpush.envs.scenes.objects import Circle, PushedObject, get_object
from modpush.envs.scenes.obstacle import Obstacle
from modpush.envs.scenes.rectangles import obstacle_distance
from modpush.envs.scenes.scenario import Scenario
from modpush.geometry.camera import Camera, cell_centers
from modpush.geometry.workspace import BOUNDS_MARGIN, WORKSPACE
from modpush.planners import LazyThetaStar, Planner, inflate, make_planner
from modpush.planners.occupancy import cells_outside


def standing_cells(obstacles: Sequence[Obstacle], camera: Camera) -> NDArray[np.bool_]:
    """Cells that an obstacle stands on, `[H, W]`."""
    return obstacle_distance(cell_centers(camera), obstacles) <= 0.0


def blocked_cells(
    scenario: Scenario,
    camera: Camera | None = None,
    objects: Mapping[str, PushedObject] | None = None,
    *,
    inflation: Circle = "circumscribed",
) -> NDArray[np.bool_]:
    """The cells that the object's centre cannot be in without a collision or the episode's end, `[H, W]`.

    They are computed from the layout, so that they are the same for every environment and method: True
    within the radius of the object's circle of a cell that an obstacle stands on, and where an episode
    is out of bounds.
    """
    camera = camera or Camera()
    standing = torch.from_numpy(standing_cells(scenario.obstacles, camera))
    radius = get_object(scenario.pushed_object, objects).radius_of(inflation) / camera.cell_size
    blocked = inflate(standing[None], radius)[0]
    return (blocked | cells_outside(camera, WORKSPACE, -BOUNDS_MARGIN)).numpy()


@checked_arguments
def shortest_path(
    scenario: Scenario,
    planner: Planner | str | None = None,
    camera: Camera | None = None,
    objects: Mapping[str, PushedObject] | None = None,
    *,
    inflation: Circle = "circumscribed",
) -> tuple[NDArray[np.float64], float]:
    """The shortest path past the obstacles from start to goal on which no episode ends.

    Args:
        scenario: Start of the episode.
        planner: A planner, or its name in `PLANNERS`; `LazyThetaStar` by default.
        camera: The camera, whose pixels are the grid's cells.
        objects: Your own objects by name, as in `PushEnv.pushed_objects`.
        inflation: Circle of the object by whose radius obstacles are inflated.

    Returns:
        Its corners `[n, 2]` [m], ends included, and its length [m]. If there is no path on
        the grid, the straight line, as in `PlannerSubgoals` at a reset.
    """
    camera = camera or Camera()
    planner = make_planner(LazyThetaStar() if planner is None else planner)
    ends = torch.tensor([scenario.object_pose[:2], scenario.goal_position], dtype=torch.float64)
    straight = ends.numpy()
    pixels = camera.project(ends).float()
    occupancy = torch.from_numpy(blocked_cells(scenario, camera, objects, inflation=inflation))[
        None
    ]
    paths = planner.plan(occupancy, pixels[:1], pixels[1:])
    if not paths.found[0]:
        return straight, float(np.linalg.norm(straight[1] - straight[0]))
    count = int(paths.count[0])
    corners = camera.unproject(paths.waypoints[0, :count].double()).numpy()
    corners[[0, -1]] = straight  # the planner's pixels are single precision
    return corners, float(np.linalg.norm(np.diff(corners, axis=0), axis=-1).sum())
