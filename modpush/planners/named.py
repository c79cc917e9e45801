"""Planners by name, and user-defined planners."""

from collections.abc import Callable
from functools import partial
from typing import Any

from modpush.parts import find_part
from modpush.planners.a_star import AStar
from modpush.planners.base import Planner
from modpush.planners.distance_field import DistanceField
from modpush.planners.lazy_theta_star import LazyThetaStar
from modpush.planners.straight_line import StraightLine

__all__ = ["PLANNERS", "make_planner"]

PLANNERS: dict[str, Callable[[], Planner]] = {
    "distance_field": DistanceField,
    "lazy_theta_star": LazyThetaStar,
    "lazy_theta_star_grid": partial(LazyThetaStar, nodes="grid"),
    "a_star": AStar,
    "straight_line": StraightLine,
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
