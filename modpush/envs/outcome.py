"""Conditions of success, of leaving the workspace, and of an episode's end."""

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from modpush.geometry.workspace import Rectangle

Goal = Literal["position", "pose"]
"""Kind of the goal: a position of the object's centre, or a pose of the object."""

GOAL_THRESHOLD = 0.05
"""By default an episode succeeds when the object's centre is this near to the goal [m]."""


def is_at_goal(
    position: NDArray[np.float64], goal: NDArray[np.float64], threshold: float = GOAL_THRESHOLD
) -> NDArray[np.bool_]:
    """True where the object's centre `[B, 2]` is within a distance of its goal `[B, 2]` [m], `[B]`."""
    x, y = (position - goal).T
    return np.hypot(x, y) <= threshold


def pose_errors(
    pose: NDArray[np.float64], goal: NDArray[np.float64], symmetry: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Distances and angles of objects from their goal poses, (x, y, yaw) `[B, 3]` each [m, rad].

    `symmetry` is the number of yaw angles at which each object looks the same, 0 for all angles, `[B]`.

    Returns:
        `[B, 2]`: the distance [m], and the angle by which the object is to be turned, counter-clockwise,
        in [-pi / symmetry, pi / symmetry) [rad].
    """
    (x, y), turn = (goal - pose)[:, :2].T, goal[:, 2] - pose[:, 2]
    period = 2 * np.pi / np.maximum(symmetry, 1)
    turn = (turn + period / 2) % period - period / 2
    return np.stack([np.hypot(x, y), np.where(symmetry > 0, turn, 0.0)], -1)


def is_out_of_bounds(position: NDArray[np.float64], bounds: Rectangle) -> NDArray[np.bool_]:
    """True where the object's centre `[B, 2]` is outside of `ScenarioConfig.bounds` [m], `[B]`."""
    (low_x, low_y), (high_x, high_y) = bounds
    x, y = position.T
    return (x < low_x) | (x > high_x) | (y < low_y) | (y > high_y)


class EpisodeStatus(NamedTuple):
    """Status of the episodes of a batch, `[B]` bool each; the fields are keys of `PushEnv`."""

    success: NDArray[np.bool_]
    """The object is at its goal, and has been there for the number of steps that was asked for."""
    out_of_bounds: NDArray[np.bool_]
    """The object has left the workspace."""
    terminated: NDArray[np.bool_]
    """The episode is over, and nothing follows that an agent should value."""
    truncated: NDArray[np.bool_]
    """The episode was cut off: what would follow still has a value."""
    done: NDArray[np.bool_]
    """Either of the two."""


def episode_status(
    success: NDArray[np.bool_],
    position: NDArray[np.float64],
    bounds: Rectangle,
    step_count: NDArray[np.int64],
    max_episode_steps: int | None,
    oob: Literal["truncate", "terminate"],
) -> EpisodeStatus:
    """Decide which episodes have ended, and how, from the object's centres `[B, 2]` [m].

    In numpy, which on a few numbers is several times faster than torch. `step_count` `[B]` is the number
    of steps since the reset, `max_episode_steps` that after which an episode is truncated (None: no
    limit), and `oob` the kind of the end out of bounds.
    """
    outside = is_out_of_bounds(position, bounds)
    terminated = success | outside if oob == "terminate" else success
    truncated = outside
    if max_episode_steps is not None:
        truncated = outside | (step_count >= max_episode_steps)
    return EpisodeStatus(success, outside, terminated, truncated, terminated | truncated)
