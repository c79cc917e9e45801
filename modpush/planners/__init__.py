"""Occupancy from depth, paths around obstacles, sub-goals on them. Needs no simulator."""

from .a_star import AStar
from .base import Paths, Planner, point_along
from .distance_field import DistanceField
from .grid import (
    SEGMENT_OBJECT,
    SEGMENT_OBSTACLE,
    SEGMENT_ROBOT,
    SEGMENT_TABLE,
    GridFrame,
)
from .lazy_theta_star import LazyThetaStar
from .occupancy import OccupancyGrid
from .occupancy_map import OccupancyMap, circumscribed_radius, inflate
from .straight_line import StraightLine
from .subgoals import PlannerSubgoals, fraction_subgoal, lookahead_subgoal
from .theta_star import ThetaStar

__all__ = [
    "SEGMENT_OBJECT",
    "SEGMENT_OBSTACLE",
    "SEGMENT_ROBOT",
    "SEGMENT_TABLE",
    "AStar",
    "DistanceField",
    "GridFrame",
    "LazyThetaStar",
    "OccupancyGrid",
    "OccupancyMap",
    "Paths",
    "Planner",
    "PlannerSubgoals",
    "StraightLine",
    "ThetaStar",
    "circumscribed_radius",
    "fraction_subgoal",
    "inflate",
    "lookahead_subgoal",
    "point_along",
    "warmup",
]


def warmup(height: int = 256, width: int = 256) -> None:
    """Compile every kernel here, or load it from the cache on disk, ahead of first use.

    The first time on a machine this takes about a minute, afterwards about a second. Without it
    each kernel is compiled when it is first called. Kernels for a batch on several threads are
    compiled where `torch.get_num_threads()` is more than 1.

    Args:
        height: Rows of the grids to be planned on; no matter for what is compiled.
        width: Their columns.
    """
    import torch

    planners = [AStar(), DistanceField(), LazyThetaStar(nodes="grid"), LazyThetaStar()]
    for planner in [*planners, StraightLine(), ThetaStar()]:
        planner.warmup(height, width)
    frame = GridFrame(height=height, width=width)
    for batch in (1, 2):
        inflate(torch.zeros(batch, height, width, dtype=torch.bool), 1.0)
        depth = torch.full((batch, height, width), frame.camera_z)
        OccupancyMap(frame)(depth, 0.035)
