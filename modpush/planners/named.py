"""Planners by name, user-defined planners, and compilation ahead of the first use."""

from collections.abc import Callable
from functools import partial
from typing import Any

import torch

from modpush._types import PixelCount
from modpush._validation import checked_arguments
from modpush.geometry.camera import Camera
from modpush.parts import find_part
from modpush.planners.a_star import AStar
from modpush.planners.any_angle import DistanceField, LazyThetaStar, StraightLine
from modpush.planners.grid_planner import Planner
from modpush.planners.occupancy_map import OccupancyMap, inflate
from modpush.planners.pose_field import PoseField
from modpush.planners.through_obstacles import ThroughObstacles

PLANNERS: dict[str, Callable[[], Planner]] = {
    "distance_field": DistanceField,
    "lazy_theta_star": LazyThetaStar,
    "lazy_theta_star_grid": partial(LazyThetaStar, nodes="grid"),
    "a_star": AStar,
    "straight_line": StraightLine,
    "through_obstacles": ThroughObstacles,
}
"""Factory of each planner, by name."""


def make_planner(planner: Any) -> Planner:
    """Make a planner from its name or `"module:name"`, or check a planner object.

    Args:
        planner: A name in `PLANNERS`; `"module:name"` of a planner, or of a class or function that
            returns one without arguments; or such an object itself. A planner is any object with a
            method `plan(occupancy, start, goal) -> Paths`, see `Planner`.

    Raises:
        ValueError: If there is no such planner.
        TypeError: If the object has no method `plan`.
    """
    found = find_part("planner", planner, PLANNERS)
    if isinstance(found, type) or (callable(found) and not hasattr(found, "plan")):
        found = found()
    if not callable(getattr(found, "plan", None)):
        raise TypeError(
            f"planner must have a method plan(occupancy, start, goal) -> Paths, got {found!r}."
        )
    return found


@checked_arguments
def warmup(height: PixelCount = 256, width: PixelCount = 256) -> None:
    """Compile every planner's kernels, or load them from the cache on disk, before their first use.

    The first call on a machine takes about a minute, later ones about a second. Without it each
    kernel is compiled when it is first called. Kernels that run a batch on several threads are
    compiled where `torch.get_num_threads()` is more than 1.

    Args:
        height: Rows of the grid used for compiling; the compiled kernels serve grids of any size.
        width: Columns of that grid.
    """
    planners = [AStar(), DistanceField(), LazyThetaStar(nodes="grid"), LazyThetaStar()]
    camera, cpu = Camera(height=height, width=width), torch.device("cpu")
    pose_field = PoseField(camera)
    for batch in (1, 2):  # one scene and several run through different kernels
        occupancy = torch.zeros(batch, height, width, dtype=torch.bool, device=cpu)
        occupancy[:, height // 2, : width // 2 + 1] = True
        start = torch.zeros(batch, 2, device=cpu)
        goal = torch.tensor([[0.0, height - 1.0]], device=cpu).repeat(batch, 1)
        for planner in [*planners, StraightLine()]:
            planner.plan(occupancy, start, goal)
        inflate(occupancy, 1.0)
        depth = torch.full(occupancy.shape, camera.z, dtype=torch.float32, device=cpu)
        OccupancyMap(camera)(depth, 0.035)
        pose = torch.tensor([[camera.x, camera.y, 0.0]], device=cpu).repeat(batch, 1)
        pose_field.plan(occupancy, torch.full((batch, 48), 0.035, device=cpu), pose, pose)
