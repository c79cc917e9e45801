"""`RobotInterface`: the methods by which an arm is driven, its states, images, commands and stops."""

from abc import ABC, abstractmethod
from typing import Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray


class RobotState(NamedTuple):
    """Report of an arm."""

    joints: NDArray[np.float64]
    """Angles of the joints, from base to flange, `[n]` [rad]."""
    stamp: float
    """Time of the report, on the clock of the depth images' stamps [s]."""


class DepthImage(NamedTuple):
    """An image of a depth camera."""

    depth: NDArray[np.float32]
    """`[H, W]` along the optical axis [m]; 0 or NaN without a reading."""
    stamp: float
    """When it was taken, on the clock of `RobotState.stamp` [s]."""


class Command(NamedTuple):
    """One control step of the tool, which points straight down. Base frame."""

    start: NDArray[np.float64]
    """x, y, yaw of the tip at which the step starts, near the measured one, `[3]` [m, m, rad]."""
    target: NDArray[np.float64]
    """x, y, yaw of the tip at the end of the step, yaw not wrapped, `[3]` [m, m, rad]."""
    height: float
    """Height of the tip over the table [m]."""
    joints: NDArray[np.float64]
    """Angles of the joints that hold the tip at `target`, `[n]` [rad]."""
    duration: float
    """Time that the step takes [s]."""
    reachable: bool
    """False if the arm cannot go where the policy wants; then `target` is `start`."""


class RobotInterface(ABC):
    """Implement these methods to run on another arm.

    The base frame is that of `modpush.envs.Robot`: x forward, y left, z up, the table's top at z = 0. A
    lost connection, and an arm that refuses to move, raise a `ConnectionError` that says what happened.
    """

    @abstractmethod
    def connect(self) -> None:
        """Connect; the arm does not move."""

    @abstractmethod
    def observe(self) -> RobotState:
        """The arm's present state."""

    @abstractmethod
    def command(self, command: Command) -> None:
        """Move the tip from where it is to the target at constant speed.

        Returns when the next command is due, `command.duration` after the last one was. Without a further
        command the arm stops by itself.
        """

    @abstractmethod
    def stop(self) -> None:
        """Stop at once and stay; does nothing if the arm is not connected."""

    @abstractmethod
    def close(self) -> None:
        """Stop and disconnect; closing twice does nothing."""


StopReason = Literal[
    "camera",
    "stale_image",
    "object_not_found",
    "object_lost",
    "pose_jump",
    "goal",
    "start",
    "workspace",
    "speed",
    "acceleration",
    "joint_limit",
    "connection",
]
"""Reason for a stop; the message says it with its numbers."""
STOP_REASONS: tuple[str, ...] = get_args(StopReason)


class Stopped(RuntimeError):
    """The arm was stopped, or did not start.

    Args:
        reason: One of `STOP_REASONS`.
        message: The same in words and numbers, and what to do about it.
    """

    reason: StopReason

    def __init__(self, reason: StopReason, message: str) -> None:
        super().__init__(f"{reason}: {message}")
        self.reason: StopReason = reason
