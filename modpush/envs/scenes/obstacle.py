"""`Obstacle`: an upright box on the table, as plain data."""

from modpush._types import Pose, Size
from modpush._validation import checked

__all__ = ["MAX_OBSTACLES", "Obstacle"]

MAX_OBSTACLES = 24
"""The most obstacles that a layout may have."""


@checked(kw_only=False)
class Obstacle:
    """An upright box on the table."""

    size: Size
    """Length, width and height [m]."""
    pose: Pose
    """x and y of the centre, and yaw of the long axis, robot's base frame [m, m, rad]."""
