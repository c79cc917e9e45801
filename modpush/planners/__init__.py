"""Occupancy from depth, paths around obstacles, sub-goals on them. Needs no simulator."""

from .a_star import AStar
from .base import Paths, Planner, point_along
from .distance_field import DistanceField
from .lazy_theta_star import LazyThetaStar
from .straight_line import StraightLine
from .theta_star import ThetaStar

__all__ = [
    "AStar",
    "DistanceField",
    "LazyThetaStar",
    "Paths",
    "Planner",
    "StraightLine",
    "ThetaStar",
    "point_along",
]
