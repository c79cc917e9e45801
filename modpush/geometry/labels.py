"""Labels of segmentation images."""

from enum import IntEnum

__all__ = ["Label"]


class Label(IntEnum):
    """Values of the segmentation image."""

    TABLE = 0
    """The table, or the background."""
    OBJECT = 1
    """The pushed object."""
    OBSTACLE = 2
    """An obstacle."""
    ROBOT = 3
    """The robot with its tool."""
