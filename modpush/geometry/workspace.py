"""The part of the table that episodes take place on."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["BOUNDS_MARGIN", "WORKSPACE", "Rectangle"]

BOUNDS_MARGIN = 0.05
"""An episode ends when the object's centre is this far outside the workspace [m]."""


class Rectangle(NamedTuple):
    """An axis-aligned rectangle on the table, in the robot's base frame."""

    low: tuple[float, float]
    """Lower corner (x, y) [m]."""
    high: tuple[float, float]
    """Upper corner (x, y) [m]."""

    def bounds(self, margin: float = BOUNDS_MARGIN) -> "Rectangle":
        """The rectangle that is larger by a margin on every side [m].

        With the default margin, where the object's centre may be before an episode ends.
        """
        (x0, y0), (x1, y1) = self
        return Rectangle((x0 - margin, y0 - margin), (x1 + margin, y1 + margin))

    def corners(self) -> NDArray[np.float64]:
        """The four corners (x, y), counter-clockwise from the lower one, `[4, 2]` [m]."""
        (x0, y0), (x1, y1) = self
        return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])


WORKSPACE = Rectangle((0.20, -0.35), (0.75, 0.35))
"""Where objects start and goals lie. Source: the authors' released simulation."""
