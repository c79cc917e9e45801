"""`Stopped`: why the arm was stopped."""

from typing import Literal, get_args

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
    """Reason for the stop, one of `STOP_REASONS`."""

    def __init__(self, reason: StopReason, message: str) -> None:
        super().__init__(f"{reason}: {message}")
        self.reason = reason
