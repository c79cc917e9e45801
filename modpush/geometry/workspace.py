"""The workspace on the table."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from modpush._types import Point
from modpush._validation import check_value

BOUNDS_MARGIN = 0.05
"""Distance of the object's centre outside the workspace at which an episode ends [m]."""


class _Corners(NamedTuple):
    low: Point
    high: Point


class Rectangle(_Corners):
    """An axis-aligned rectangle on the table, in the robot's base frame.

    Attributes:
        low: Lower corner (x, y) [m].
        high: Upper corner (x, y) [m].

    Raises:
        ValueError: If a corner is not a pair of finite numbers, or the lower one is not below the upper.
    """

    __slots__ = ()

    def __new__(cls, low: tuple[float, float], high: tuple[float, float]) -> "Rectangle":
        low, high = check_value("low", low, Point), check_value("high", high, Point)
        if not (low[0] < high[0] and low[1] < high[1]):
            raise ValueError(f"Rectangle: low must be < high, got {low} and {high}.")
        return super().__new__(cls, low, high)

    def bounds(self, margin: float = BOUNDS_MARGIN) -> "Rectangle":
        """The rectangle enlarged by a margin on every side [m].

        With the default margin, an episode ends when the object's centre is outside it.
        """
        (x0, y0), (x1, y1) = self
        if not -min(x1 - x0, y1 - y0) < 2 * margin < math.inf:
            raise ValueError(
                f"Rectangle.bounds: margin must be finite and leave an area, got {margin}."
            )
        return Rectangle((x0 - margin, y0 - margin), (x1 + margin, y1 + margin))

    def time_to_edge(self, place: NDArray[np.float64], velocity: NDArray[np.float64]) -> float:
        """Time after which a point that moves is at the edge ahead of it [s].

        It is infinite for a point that stands, or that is outside and moves away. `place` and `velocity`
        are (x, y), `[2]` [m, m/s].
        """
        edges = np.where(velocity > 0, self.high, self.low)
        with np.errstate(divide="ignore", invalid="ignore"):
            times = np.where(velocity == 0, np.inf, (edges - place) / velocity)
        return float(np.where(times < 0, np.inf, times).min())

    def corners(self) -> NDArray[np.float64]:
        """The four corners (x, y), counter-clockwise from the lower one, `[4, 2]` [m]."""
        (x0, y0), (x1, y1) = self
        return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])


WORKSPACE = Rectangle((0.20, -0.35), (0.75, 0.35))
"""Area of starts and goals. Source: The authors' released simulation."""
