"""Metrics of an episode, as pure functions of its recorded positions, contacts and rewards."""

import math
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from modpush._types import NonNegative, Positive
from modpush._validation import checked_arguments
from modpush.envs.scenes.obstacle import OBSTACLE_MASS
from modpush.geometry.workspace import WORKSPACE

Flags = NDArray[np.bool_]
_TOPPLED = math.radians(45)  # of an obstacle's vertical axis
_OTHER_SIDE = math.radians(45)
_MOVED = 0.001  # shorter displacements of the tip within a control step are no move [m]


@dataclass(frozen=True, kw_only=True)
class EpisodeMetrics:
    """Metrics of one episode."""

    success: bool
    """The object reached the goal, by default when its centre came within 5 cm of it."""
    steps: int
    """Number of control steps."""
    episode_return: float
    """Sum of the environment's rewards."""
    contact_rate: float
    """Share of the control steps in contact, from the first contact on; 0 if there was none. A step
    counts in which any of four looks, spread over it, shows contact."""
    contact_rate_at_end: float
    """The same of the looks at the steps' ends alone."""
    collision_rate: float
    """Share of all control steps in which the object, the tool or the arm touched an obstacle."""
    collision_rate_object: float
    """Share of all control steps in which the object touched an obstacle."""
    collision_rate_arm: float
    """Share of all control steps in which the tool or the arm touched an obstacle."""
    collision_rate_at_end: float
    """Share of all control steps at whose end the object, the tool or the arm touched an obstacle."""
    collision_rate_object_at_end: float
    """Share of all control steps at whose end the object touched an obstacle."""
    path_length: float
    """Length of the object's path, plus its distance to the goal at the end [m]."""
    final_distance: float
    """Distance from the object to the goal at the end [m]."""
    shortest_length: float
    """Length of the shortest path at reset, see `shortest_path` [m]."""
    spl: float
    """Success weighted by path length, against the exact shortest path."""
    out_of_bounds: bool
    """The object left the workspace."""
    mean_jerk: float
    """Mean jerk of the tool's tip, see `mean_jerk` [m/s^3]."""
    reversal_rate: float
    """Share of the tip's moves against the one before, see `reversal_rate`."""
    final_yaw_error: float | None = None
    """Angle by which the object's yaw differs from that of its goal pose at the end, modulo its symmetry
    [rad]; None where the goal is a position."""
    path_share: float | None = None
    """Share of the straight way to the goal that the object has covered at the end, see `path_share`."""
    effort: float | None = None
    """Share of the object in all that was moved, see `effort_score`; None where obstacles are fixed."""
    objects_toppled: int | None = None
    """Number of obstacles that lie on another side at the end; None where obstacles are fixed."""
    objects_off: int | None = None
    """Number of obstacles whose centre is more than 5 cm outside the workspace at the end; None where
    obstacles are fixed."""
    side_changes: int | None = None
    """Number of changes of the side from which the object is pushed, see `side_changes`."""

    def to_dict(self) -> dict[str, float | int | bool]:
        """The metrics by name, those that are None left out."""
        return {name: value for name, value in asdict(self).items() if value is not None}


def contact_rate(contact: Flags) -> float:
    """Share of the steps `[T]` in contact, from the first contact on; 0 if there was none."""
    touched = np.flatnonzero(contact)
    return float(np.mean(contact[touched[0] :])) if len(touched) else 0.0


def collision_rate(*collisions: Flags) -> float:
    """Share of the steps in which any of several collisions `[T]` occurred; 0 without steps."""
    together = np.logical_or.reduce(collisions)
    return float(together.mean()) if together.size else 0.0


def pushed_length(position: NDArray[np.float64], goal: NDArray[np.float64]) -> tuple[float, float]:
    """Length of the path `[T + 1, 2]` plus its end's distance to the goal, and that distance [m]."""
    final = float(np.linalg.norm(position[-1] - goal))
    return float(np.linalg.norm(np.diff(position, axis=0), axis=-1).sum()) + final, final


def mean_jerk(position: NDArray[np.float64], control_freq: float) -> float:
    """Mean length of the third derivative of a position `[T + 1, 2]`, from third differences [m/s^3]."""
    jerk = np.linalg.norm(np.diff(position, n=3, axis=0), axis=-1) * control_freq**3
    return float(jerk.mean()) if jerk.size else 0.0


def reversal_rate(position: NDArray[np.float64]) -> float:
    """Share of a point's moves that are turned by more than 90 degrees from the one before.

    Steps in which it moved by less than 1 mm are left out; 0 for fewer than two moves.
    """
    moves = np.diff(position, axis=0)
    moves = moves[np.linalg.norm(moves, axis=-1) >= _MOVED]
    turned = (moves[1:] * moves[:-1]).sum(-1) < 0
    return float(turned.mean()) if turned.size else 0.0


def success_weighted_by_path_length(success: bool, shortest: float, taken: float) -> float:
    """Success weighted by path length, `S * l / max(p, l)`, of the shortest path l and the taken p [m].

    Source: Anderson et al. 2018, "On Evaluation of Embodied Navigation Agents"; paper Sec. V.
    """
    return float(success) * shortest / max(taken, shortest)


def path_share(success: bool, start: float, end: float) -> float:
    """Share of the straight way to the goal that was covered, from its distances at start and end [m].

    1 for a success; 0 where the object has come no nearer.
    """
    return 1.0 if success else max(0.0, 1.0 - end / start)


def effort_score(
    mass: float, length: float, masses: NDArray[np.float64], lengths: NDArray[np.float64]
) -> float:
    """Share of the pushed object in all that was moved, `m0 l0 / (m0 l0 + sum mi li)`.

    Masses [kg] and lengths of the paths [m] of the object and of the obstacles `[n]`; 1 if nothing else
    was moved. Source: Zhong et al. 2025, "Bench-Push", where the pushing robot stands for the object.
    """
    own, others = mass * length, float(np.dot(masses, lengths))
    return own / (own + others) if others > 0 else 1.0


def side_changes(
    object_pose: NDArray[np.float64], ee_position: NDArray[np.float64], contact: Flags
) -> int:
    """Number of changes of the side from which an object is pushed.

    A side is the direction from the object's centre to the tool's tip, in the object's frame; another
    one differs by more than 45 degrees from that of the last change, or of the first contact. Poses `[T,
    3]`, positions `[T, 2]` and contacts `[T]` are those at the steps' ends.
    """
    way = (ee_position - object_pose[:, :2])[contact]
    directions = np.arctan2(way[:, 1], way[:, 0]) - object_pose[contact, 2]
    changes, side = 0, directions[0] if len(directions) else 0.0
    for direction in directions[1:]:
        if abs(math.remainder(direction - side, 2 * math.pi)) > _OTHER_SIDE:
            changes, side = changes + 1, direction
    return changes


def obstacle_metrics(
    object_mass: float, object_length: float, poses: NDArray[np.float64]
) -> dict[str, float | int]:
    """`effort`, `objects_toppled` and `objects_off` of an episode.

    `poses` are x, y, yaw and tilt of the obstacles at reset and after each step, `[T + 1, n, 4]`.
    """
    lengths = np.linalg.norm(np.diff(poses[..., :2], axis=0), axis=-1).sum(0)
    masses = np.full(len(lengths), OBSTACLE_MASS)
    low, high = WORKSPACE.bounds()
    place, tilt = poses[-1, :, :2], poses[-1, :, 3]
    outside = (place < low) | (place > high)
    return {
        "effort": effort_score(object_mass, object_length, masses, lengths),
        "objects_toppled": int((tilt > _TOPPLED).sum()),
        "objects_off": int(outside.any(-1).sum()),
    }


@checked_arguments
def episode_metrics(
    *,
    object_position: NDArray[np.float64],
    ee_position: NDArray[np.float64],
    goal_position: NDArray[np.float64],
    reward: NDArray[np.float64],
    contacts: Flags,
    contacts_at_end: Flags,
    control_freq: Positive,
    success: bool,
    out_of_bounds: bool,
    shortest_length: Positive,
    final_yaw_error: NonNegative | None = None,
) -> EpisodeMetrics:
    """All metrics of an episode of T control steps.

    Args:
        object_position: The object's position at reset and after each step, `[T + 1, 2]` [m].
        ee_position: The same of the tool's tip, `[T + 1, 2]` [m].
        goal_position: The goal's position, `[2]` [m].
        reward: Rewards of the steps, `[T]`.
        contacts: Contacts during each step, `[T, 3]` bool: of tool or arm and object, of object and
            obstacle, of tool or arm and obstacle.
        contacts_at_end: The same contacts at each step's end, `[T, 3]` bool.
        control_freq: Control steps per second [Hz].
        success: True if the goal was reached.
        out_of_bounds: True if the object left the workspace.
        shortest_length: See `shortest_path` [m].
        final_yaw_error: Angle that is missing to a goal pose at the end [rad].

    Raises:
        ValueError: If an array has another dtype or length, or a number is not finite or out of range.
    """
    steps = len(object_position) - 1
    for name, value, shape in (
        ("object_position", object_position, (steps + 1, 2)),
        ("ee_position", ee_position, (steps + 1, 2)),
        ("goal_position", goal_position, (2,)),
        ("reward", reward, (steps,)),
        ("contacts", contacts, (steps, 3)),
        ("contacts_at_end", contacts_at_end, (steps, 3)),
    ):
        kind = np.bool_ if "contacts" in name else np.floating
        if not np.issubdtype(value.dtype, kind) or value.shape != shape:
            raise ValueError(
                f"{name} must be {kind.__name__} {list(shape)}, by the length of object_position [T + 1, "
                f"2], got {value.dtype} {list(value.shape)}."
            )
        if not np.isfinite(value).all():
            raise ValueError(f"{name} must be finite, got {value}.")
    pushed, object_hit, arm_hit = contacts.T
    pushed_at_end, object_hit_at_end, arm_hit_at_end = contacts_at_end.T
    taken, final = pushed_length(object_position, goal_position)
    return EpisodeMetrics(
        success=bool(success),
        steps=steps,
        episode_return=float(np.sum(reward)),
        contact_rate=contact_rate(pushed),
        contact_rate_at_end=contact_rate(pushed_at_end),
        collision_rate=collision_rate(object_hit, arm_hit),
        collision_rate_object=collision_rate(object_hit),
        collision_rate_arm=collision_rate(arm_hit),
        collision_rate_at_end=collision_rate(object_hit_at_end, arm_hit_at_end),
        collision_rate_object_at_end=collision_rate(object_hit_at_end),
        path_length=taken,
        final_distance=final,
        shortest_length=shortest_length,
        spl=success_weighted_by_path_length(success, shortest_length, taken),
        out_of_bounds=bool(out_of_bounds),
        mean_jerk=mean_jerk(ee_position, control_freq),
        reversal_rate=reversal_rate(ee_position),
        final_yaw_error=final_yaw_error,
    )
