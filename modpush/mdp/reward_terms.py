"""The terms of the reward.

The paper's reward (Sec. IV-B) is the sum of a distance part (eq. 2), a collision part (eq. 3) and a
contact part (eq. 4).
"""

from collections.abc import Callable

from torch import Tensor

from modpush.mdp.step_outcome import StepOutcome

RewardTerm = Callable[[StepOutcome], Tensor]
"""`StepOutcome -> [..., 1]`, before its weight."""

_NEAR = 0.04  # way to a goal pose that counts as near [m]


def goal(outcome: StepOutcome) -> Tensor:
    """1 on reaching the goal. Source: Sec. IV-B, eq. 2."""
    return outcome.success.float()


def distance(outcome: StepOutcome) -> Tensor:
    """Penalty for the path still to go, -1 at reset, 0 on reaching the goal. Source: eq. 2."""
    return -outcome.path_fraction * ~outcome.success


def approach(outcome: StepOutcome) -> Tensor:
    """Penalty for the tool's distance from the object, -1 at reset, 0 on success. Source: eq. 2."""
    return -outcome.approach_fraction * ~outcome.success


def touch(outcome: StepOutcome) -> Tensor:
    """Takes the penalty of `approach` back while the tool touches the object. Source: eq. 4."""
    return outcome.approach_fraction * outcome.object_contact


def object_collision(outcome: StepOutcome) -> Tensor:
    """-1 where the object touches an obstacle. Source: eq. 3."""
    return -outcome.obstacle_contact.float()


def tool_collision(outcome: StepOutcome) -> Tensor:
    """-1 where the tool or the arm touches an obstacle. Source: the authors' code."""
    return -outcome.tool_obstacle_contact.float()


def out_of_bounds(outcome: StepOutcome) -> Tensor:
    """-1 where the object leaves the workspace. Source: eq. 3."""
    return -outcome.out_of_bounds.float()


def window(outcome: StepOutcome) -> Tensor:
    """-1 where the tool is outside the local window. Source: the authors' code."""
    return -outcome.outside_window.float()


def no_contact(outcome: StepOutcome) -> Tensor:
    """-1 where the tool does not touch the object, 0 on reaching the goal. Not in the paper."""
    return -(~outcome.object_contact & ~outcome.success).float()


def detour(outcome: StepOutcome) -> Tensor:
    """Penalty in [-0.05, 0] [m] for moving the object without progress along the path.

    It is the distance that the object moved in this step, less the length by which the planned path
    became shorter. Not in the paper.
    """
    moved = (outcome.object_pose - outcome.object_pose_before)[..., :2].norm(dim=-1, keepdim=True)
    progress = outcome.path_length_before - outcome.path_length
    return -(moved - progress).clamp(0.0, 0.05)


def pose_progress(outcome: StepOutcome) -> Tensor:
    """Progress of the object towards its goal pose [m]; the last 4 cm count three times.

    The last corrections of place and yaw are short: without that they would earn little beside the way
    there. The way is path and turn, planned together (`PoseSubgoals`) or `pose_length`. Not in the paper.
    """
    before, after = outcome.pose_length_before, outcome.pose_length
    return before - after + 2 * (before.clamp_max(_NEAR) - after.clamp_max(_NEAR))


REWARD_TERMS: dict[str, RewardTerm] = {
    "goal": goal,
    "distance": distance,
    "approach": approach,
    "touch": touch,
    "object_collision": object_collision,
    "tool_collision": tool_collision,
    "out_of_bounds": out_of_bounds,
    "window": window,
    "no_contact": no_contact,
    "detour": detour,
    "pose_progress": pose_progress,
}
"""The terms that the library brings, by name; `RewardConfig.weights` says what each counts."""
