"""`Obstacle`: an upright box on the table, as plain data."""

from dataclasses import dataclass

__all__ = ["MAX_OBSTACLES", "Obstacle"]

MAX_OBSTACLES = 24
"""The most obstacles that a layout may have."""


@dataclass(frozen=True)
class Obstacle:
    """An upright box on the table."""

    size: tuple[float, float, float]
    """Length, width and height [m]."""
    pose: tuple[float, float, float]
    """x and y of the centre, and yaw of the long axis, robot's base frame [m, m, rad]."""
