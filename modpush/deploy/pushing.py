"""`push`: one push to a goal, from the first image to the last command."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import NamedTuple

from modpush.deploy.guard import Guard
from modpush.deploy.robot_interface import Command, DepthImage

_LOOKS = 5  # images before the approach, of which the map of the table becomes an average


class Pushed(NamedTuple):
    """Outcome of a push."""

    success: bool
    """True if the object has arrived, by the last image."""
    steps: int
    """Number of commands."""


def push(
    guard: Guard,
    read_depth: Callable[[], DepthImage],
    goal: Sequence[float],
    *,
    guess: Sequence[float] | None = None,
    approach: Callable[[], None] | None = None,
    max_steps: int = 200,
    on_step: Callable[[DepthImage, Command | None], None] | None = None,
) -> Pushed:
    """Push the object to a goal.

    The arm is stopped at the end, whatever ends it.

    Args:
        guard: The guard of a connected arm, with its controller.
        read_depth: Gives the newest depth image.
        goal: x, y of the object's goal [m], and its yaw [rad] for an agent of goal poses.
        guess: Place (x, y) or pose (x, y, yaw) near which the object is, to within 6 cm [m, m, rad];
            needed where an obstacle has the object's shape, from which no depth image tells it. None
            looks everywhere.
        approach: Brings the tool from aside to where the push begins, at the height of its tip. It is
            called after the first images, in which the arm hides nothing then. None where the tool is
            there already.
        max_steps: Number of commands after which the push has failed.
        on_step: Called with each image and the command that follows from it, None at the goal.

    Raises:
        Stopped: If a check of the guard fails.
    """
    controller = guard.controller
    try:
        controller.reset(goal, guess)
        if approach is not None:
            for _ in range(_LOOKS):
                state, image = guard.observe(), guard.read_image(read_depth)
                controller.look(image.depth, state.joints)
            approach()
        guard.begin()
        for step in range(max_steps + 1):
            state, image = guard.observe(), guard.read_image(read_depth)
            command = controller.act(image.depth, state.joints)
            guard.check_view()
            done = controller.success or step == max_steps
            if on_step is not None:
                on_step(image, None if done else command)
            if done:
                break
            guard.command(command)
        return Pushed(controller.success, step)
    finally:
        with suppress(ConnectionError):
            guard.arm.stop()
