"""`Limits`: the bounds within which a `Guard` lets an arm move."""

import math

from modpush._types import Fraction, Length, NonNegative, Point, Positive
from modpush._validation import checked
from modpush.envs.robot.control import MotionConfig

_RATE = 15.0  # of the shipped agents [Hz]
_STEP = MotionConfig.max_step * math.sqrt(2)  # of a control step, in x and y together [m]


@checked
class Limits:
    """Bounds of motion and perception.

    The defaults are just above what the shipped agents do at 15 Hz.
    """

    low: Point = MotionConfig.low
    """Lower corner (x, y) of the tip's workspace [m]."""
    high: Point = MotionConfig.high
    """Upper corner (x, y) of the tip's workspace [m]."""
    height_tolerance: Length = 0.005
    """Largest difference of the tip's height from the commanded one [m]."""
    tilt: Positive = math.radians(2)
    """Largest angle between tool and vertical [rad]."""
    speed: Positive = 1.05 * _STEP * _RATE
    """Largest speed of the tip [m/s]."""
    turn_speed: Positive = 1.05 * MotionConfig.max_turn * _RATE
    """Largest angular speed of the tool [rad/s]."""
    joint_speed: Positive = math.pi
    """Largest speed of a joint that a command may ask for [rad/s]."""
    acceleration: Positive = 1.05 * 2 * _STEP * _RATE**2
    """Largest change of the commanded velocity in a control step, over its length [m/s^2]. A policy may
    turn back from one step to the next."""
    joint_margin: NonNegative = 0.02
    """Distance that joints keep from their limits [rad]."""
    image_age: Positive = 0.2
    """Largest age of a depth image [s]."""
    pose_jump: Length = 0.06
    """Largest distance of the object's poses in consecutive images, more than a tool pushes it [m]."""
    yaw_jump: Positive = math.radians(60)
    """Largest difference of their yaw angles, modulo the object's symmetry [rad]."""
    lost_for: Positive = 2.0
    """Time for which images may fail to confirm the object's pose, which is predicted meanwhile [s]. The
    arm may hide the object for a second and more."""
    in_view: Fraction = 0.99
    """Share of the workspace that must lie within the camera's image."""
    readings: Fraction = 0.3
    """Share of an image's pixels that must have a depth."""

    def __post_init__(self) -> None:
        """Check the corners."""
        if not (self.low[0] < self.high[0] and self.low[1] < self.high[1]):
            raise ValueError(f"Limits: low must be < high, got {self.low} and {self.high}.")
