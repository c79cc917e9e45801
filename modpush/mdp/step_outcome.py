"""Inputs of a term of the reward."""

from collections.abc import Mapping
from functools import cached_property

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor

from modpush._checks import read_key
from modpush._types import Key
from modpush._validation import checked


@checked
class RewardKeys:
    """Keys that the terms of the reward read; lengths [m], angles [rad], robot's base frame."""

    object_pose: Key = "object_pose"
    """`[..., 3]` (x, y, yaw)."""
    ee_pose: Key = "ee_pose"
    """`[..., 3]` (x, y, yaw) of the tool's tip."""
    path_length: Key = "path_length"
    """`[..., 1]`."""
    pose_error: Key = "pose_error"
    """`[..., 2]`: distance from the goal pose, and angle to it; read by `pose_progress` alone."""
    object_radius: Key = "object_radius"
    """`[..., 1]`; read by `pose_progress` alone."""
    pose_path_length: Key = "pose_path_length"
    """`[..., 1]`; read by `pose_progress` alone, where a planner of poses provides it."""
    success: Key = "success"
    """`[..., 1]` bool."""
    object_contact: Key = "object_contact"
    """`[..., 1]` bool."""
    obstacle_contact: Key = "obstacle_contact"
    """`[..., 1]` bool."""
    tool_obstacle_contact: Key = "tool_obstacle_contact"
    """`[..., 1]` bool."""
    out_of_bounds: Key = "out_of_bounds"
    """`[..., 1]` bool."""
    action: Key = "action"
    """`[..., 3]`, read at the root by terms that ask for the action."""


class StateBefore:
    """The state before a step, read by the tensordict's keys."""

    def __init__(self, tensordict: TensorDictBase) -> None:
        self._tensordict = tensordict

    def __getitem__(self, key: NestedKey) -> Tensor:
        return read_key(self._tensordict, key)


class StepOutcome:
    """Outcome of a step: the inputs of a term of the reward.

    The attributes are quantities of the pushing task. Any other key of the tensordict is read by
    indexing: `outcome["my_key"]` after the step, `outcome.before["my_key"]` before it, and
    `outcome["action"]` is the agent's action. Nothing is read or computed before a term asks for it.

    Args:
        before: The tensordict before the step, with the action.
        after: The tensordict after the step.
        keys: Key of each quantity, by its default name.
        unit: Path length, and distance from the tool's tip to the object's centre, that count as 1,
            `[..., 2]` [m].
        window_radius: Distance of tip and object beyond which the tip is outside the window [m].
        clip: Clip `fractions` at 1.
    """

    object_pose: Tensor
    """The object's pose (x, y, yaw) after the step, base frame, `[..., 3]` [m, rad]."""
    path_length: Tensor
    """Length of the planned path to the goal after the step, `[..., 1]` [m]."""
    success: Tensor
    """True where the object is at the goal, `[..., 1]` bool."""
    object_contact: Tensor
    """True where the tool touches the object, `[..., 1]` bool."""
    obstacle_contact: Tensor
    """True where the object touches an obstacle, `[..., 1]` bool."""
    tool_obstacle_contact: Tensor
    """True where the tool or the arm touches an obstacle, `[..., 1]` bool."""
    out_of_bounds: Tensor
    """True where the object left the workspace, `[..., 1]` bool."""

    def __init__(
        self,
        before: TensorDictBase,
        after: TensorDictBase,
        keys: Mapping[str, NestedKey],
        unit: Tensor,
        window_radius: float,
        *,
        clip: bool = True,
    ) -> None:
        self.before = StateBefore(before)
        self._after, self._keys, self._unit = after, keys, unit
        self._window_radius, self._clip = window_radius, clip

    def __getitem__(self, key: NestedKey) -> Tensor:
        """The value under any key after the step; the action is that of the step.

        Raises:
            KeyError: If there is none; the message lists the keys.
        """
        if key == self._keys["action"]:
            return self.before[key]
        return read_key(self._after, key)

    def __getattr__(self, name: str) -> Tensor:
        """The quantities above, which are read as they are, once each."""
        if name not in StepOutcome.__annotations__:
            raise AttributeError(f"StepOutcome has no {name!r}.")
        value = self.__dict__[name] = read_key(self._after, self._keys[name])
        return value

    @property
    def action(self) -> Tensor:
        """The agent's action, `[..., 3]` in [-1, 1]."""
        return self.before[self._keys["action"]]

    @property
    def object_pose_before(self) -> Tensor:
        """The object's pose before the step, `[..., 3]` [m, rad]."""
        return self.before[self._keys["object_pose"]]

    @property
    def path_length_before(self) -> Tensor:
        """Length of the planned path to the goal before the step, `[..., 1]` [m]."""
        return self.before[self._keys["path_length"]]

    @property
    def pose_length(self) -> Tensor:
        """Way to the goal pose after the step, `[..., 1]` [m].

        It is `pose_path_length` of a planner of poses where there is one, otherwise `pose_length`.
        """
        return self._pose_length(self)

    @property
    def pose_length_before(self) -> Tensor:
        """The same before the step, `[..., 1]` [m]."""
        return self._pose_length(self.before)

    def _pose_length(self, state: "StepOutcome | StateBefore") -> Tensor:
        planned = self._keys["pose_path_length"]
        if self._after.get(planned, None) is not None:
            return state[planned]
        names = ("path_length", "pose_error", "object_radius")
        path_length, error, radius = (state[self._keys[name]] for name in names)
        return pose_length(path_length, error[..., 1:], radius)

    @cached_property
    def lengths(self) -> Tensor:
        """Path length, and distance from tip to object, after the step, `[..., 2]` [m]."""
        return measure_lengths(self._after, self._keys)

    @cached_property
    def fractions(self) -> Tensor:
        """`lengths` as fractions of those that count as 1, by default clipped at 1, `[..., 2]`."""
        fractions = self.lengths / self._unit.clamp_min(1e-6)
        return fractions.clamp_max(1.0) if self._clip else fractions

    @property
    def path_fraction(self) -> Tensor:
        """The paper's g_dist: path length over that at reset, `[..., 1]`, clipped as `fractions`."""
        return self.fractions[..., :1]

    @property
    def approach_fraction(self) -> Tensor:
        """The paper's o_dist: distance from tip to object over that at reset, `[..., 1]`.

        Clipped as `fractions` are.
        """
        return self.fractions[..., 1:]

    @property
    def outside_window(self) -> Tensor:
        """True where the tip is farther from the object than the window's edge, `[..., 1]` bool."""
        return self.lengths[..., 1:] > self._window_radius


def pose_length(path_length: Tensor, turn: Tensor, radius: Tensor) -> Tensor:
    """Way to a goal pose, `[..., 1]` [m].

    Along the path [m] and, at a right angle to it, the way of the object's outermost point, at a radius
    [m], by its turn [rad]: `hypot(path_length, 2 radius sin(turn / 2))`. All are `[..., 1]`.
    """
    return torch.hypot(path_length, 2 * radius * torch.sin(turn / 2))


def measure_lengths(tensordict: TensorDictBase, keys: Mapping[str, NestedKey]) -> Tensor:
    """Path length, and distance from the tool's tip to the object's centre, `[..., 2]` [m].

    `keys` has those of `ee_pose`, `object_pose` and `path_length`.
    """
    tip = read_key(tensordict, keys["ee_pose"], 3)
    centre = read_key(tensordict, keys["object_pose"], 3)
    distance = (tip[..., :2] - centre[..., :2]).norm(dim=-1, keepdim=True)
    return torch.cat([read_key(tensordict, keys["path_length"], 1), distance], -1).float()
