"""What a pixel of a segmentation image shows."""

from enum import IntEnum

__all__ = ["Label"]


class Label(IntEnum):
    """Values of the segmentation image."""

    TABLE = 0
    """The table, or nothing at all."""
    OBJECT = 1
    """The pushed object."""
    OBSTACLE = 2
    """An obstacle."""
    ROBOT = 3
    """The robot with its tool."""
