"""`Obstacle`: an upright box on the table, and `Patrol`: its motion, as plain data."""

import math
from dataclasses import asdict
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Le
from numpy.typing import ArrayLike, NDArray
from pydantic import Strict

from modpush._types import Finite, NonNegativeLength, Pose, Size
from modpush._validation import checked
from modpush.geometry.workspace import WORKSPACE

MAX_OBSTACLES = 24
"""The most obstacles that a layout may have."""
OBSTACLE_MASS = 0.5
"""Mass of an obstacle that can be moved, of whatever size [kg]."""
OBSTACLE_COLOR = (0.30, 0.33, 0.38)
"""Red, green and blue of an obstacle in rendered pictures."""

Speed = Annotated[Finite, Ge(-1), Le(1)]
"""Velocity along an axis [m/s]; an arm's tool moves at 0.3 m/s."""
_LEAST_SPEED, _LEAST_WAY = 1e-3, 1e-2
_TABLE = WORKSPACE.bounds(0.1)


@checked
class Patrol:
    """Motion of an obstacle back and forth on a straight line, at a constant speed and yaw.

    The place follows from the time since the episode's start alone.

    Raises:
        ValueError: If the speed is below 1 mm/s, or the line shorter than 1 cm.
    """

    velocity: Annotated[tuple[Speed, Speed], Strict(False)]
    """Velocity at the episode's start, x and y in the robot's base frame [m/s]."""
    ahead: NonNegativeLength
    """Distance from `Obstacle.pose` along the velocity at which the obstacle reverses [m]."""
    behind: NonNegativeLength
    """Distance from `Obstacle.pose` against the velocity at which it reverses again [m]."""

    def __post_init__(self) -> None:
        if math.hypot(*self.velocity) < _LEAST_SPEED:
            raise ValueError(
                f"Patrol: velocity must be at least {_LEAST_SPEED} m/s (an obstacle that stands has "
                f"motion=None), got {self.velocity}."
            )
        if self.ahead + self.behind < _LEAST_WAY:
            raise ValueError(
                f"Patrol: ahead and behind must be at least {_LEAST_WAY} m together, got {self.ahead} "
                f"and {self.behind}."
            )

    def at(self, time: ArrayLike) -> NDArray[np.float64]:
        """Displacement from the start (x, y) [m] and velocity (x, y) [m/s] at times.

        Args:
            time: Times since the episode's start, `[...]` [s].

        Returns:
            `[..., 4]`.
        """
        speed, way = math.hypot(*self.velocity), self.ahead + self.behind
        phase = (np.asarray(time, dtype=np.float64) * speed + self.behind) % (2 * way)
        forward = phase < way
        place = np.where(forward, phase, 2 * way - phase) - self.behind
        velocity = np.array(self.velocity)
        moved = place[..., None] * (velocity / speed)
        return np.concatenate([moved, np.where(forward, 1.0, -1.0)[..., None] * velocity], -1)


@checked(kw_only=False)
class Obstacle:
    """An upright box on the table.

    Raises:
        ValueError: If its motion leads more than 10 cm out of the workspace.
    """

    size: Size
    """Length, width and height [m]."""
    pose: Pose
    """x and y of the centre, and yaw of the long axis, robot's base frame [m, m, rad]; where it moves by
    itself, those at the episode's start."""
    motion: Patrol | None = None
    """Motion of a moving obstacle, which nothing stops; None for one that stands."""

    def __post_init__(self) -> None:
        (x0, y0), (x1, y1) = _TABLE
        ends = self.ends()
        if len(ends) and not (((x0, y0) <= ends) & (ends <= (x1, y1))).all():
            raise ValueError(
                f"Obstacle: motion must keep the centre within {tuple(_TABLE)}, got a patrol between "
                f"{ends[0].round(3).tolist()} and {ends[1].round(3).tolist()}."
            )

    def at(self, time: ArrayLike) -> NDArray[np.float64]:
        """Place of the centre (x, y) [m] and velocity (x, y) [m/s] at times.

        Args:
            time: Times since the episode's start, `[...]` [s].

        Returns:
            `[..., 4]`.
        """
        if self.motion is None:
            return np.broadcast_to((*self.pose[:2], 0.0, 0.0), (*np.shape(time), 4))
        return self.motion.at(time) + np.array([*self.pose[:2], 0.0, 0.0])

    def after(self, time: float) -> "Obstacle":
        """The obstacle of an episode that starts at a time [s] of this one's episode."""
        if self.motion is None:
            return self
        x, y, vx, vy = self.at(time).tolist()
        way = self.motion.ahead + self.motion.behind
        behind, _ = self.ends() if (vx, vy) == self.motion.velocity else self.ends()[::-1]
        passed = min(math.hypot(x - behind[0], y - behind[1]), way)
        patrol = Patrol(velocity=(vx, vy), ahead=way - passed, behind=passed)
        return Obstacle(self.size, (x, y, self.pose[2]), patrol)

    def standing(self, time: float) -> "Obstacle":
        """The obstacle as it is at a time [s] since the episode's start, without its motion."""
        if self.motion is None:
            return self
        x, y, _, _ = self.at(time).tolist()
        return Obstacle(self.size, (x, y, self.pose[2]))

    def ends(self) -> NDArray[np.float64]:
        """Places of the centre where it reverses, `[2, 2]`, or `[0, 2]` for one that stands [m]."""
        if self.motion is None:
            return np.empty((0, 2))
        direction = np.array(self.motion.velocity) / math.hypot(*self.motion.velocity)
        ways = np.array([[-self.motion.behind], [self.motion.ahead]])
        return np.array(self.pose[:2]) + ways * direction

    def to_dict(self) -> dict[str, Any]:
        """Plain data; `motion` only where it moves."""
        return {k: v for k, v in asdict(self).items() if (k, v) != ("motion", None)}
