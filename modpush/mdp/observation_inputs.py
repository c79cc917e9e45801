"""Inputs of an entry of the observation."""

import math
from collections.abc import Mapping
from functools import cached_property

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor

from modpush._checks import read_key
from modpush._types import Key
from modpush._validation import checked
from modpush.geometry.frames import Frame, frame_yaw, rotate

_LAST = {
    "object_pose": (3,),
    "goal_position": (2,),
    "goal_pose": (3,),
    "pose_error": (2,),
    "ee_pose": (3,),
    "object_radius": (1,),
    "object_symmetry": (1,),
    "path_length": (1,),
    "subgoal": (2,),
    "subgoal_pose": (3,),
    "pose_path_length": (1,),
    "last_action": (3,),
    "obstacle_motion": (4,),
    "object_dynamics": (4,),
    "history": (8, 10),
}
"""Last dimensions of the quantities that have always the same."""


@checked
class ObservationKeys:
    """Keys that the entries of an observation read; lengths [m], angles [rad], robot's base frame."""

    object_pose: Key = "object_pose"
    """`[..., 3]` (x, y, yaw)."""
    goal_position: Key = "goal_position"
    """`[..., 2]`."""
    goal_pose: Key = "goal_pose"
    """`[..., 3]` (x, y, yaw)."""
    pose_error: Key = "pose_error"
    """`[..., 2]`: distance of the object from its goal pose, and angle by which it is to be turned."""
    ee_pose: Key = "ee_pose"
    """`[..., 3]` (x, y, yaw) of the tool's tip."""
    joint_position: Key = "joint_position"
    """`[..., 6]`."""
    object_radius: Key = "object_radius"
    """`[..., 1]`."""
    object_symmetry: Key = "object_symmetry"
    """`[..., 1]`: number of yaw angles at which the object looks the same, 0 for all."""
    object_support: Key = "object_support"
    """`[..., n]`: how far the object reaches in n directions of its own."""
    object_contact: Key = "object_contact"
    """`[..., 1]` bool."""
    path_length: Key = "path_length"
    """`[..., 1]`."""
    subgoal: Key = "subgoal"
    """`[..., 2]`."""
    subgoal_past: Key = "subgoal_past"
    """`[..., lags, 2]`."""
    path_ahead: Key = "path_ahead"
    """`[..., n, 2]`: points along the planned path."""
    obstacle_motion: Key = "obstacle_motion"
    """`[..., 4]`: place and velocity of an obstacle, zeros for none."""
    object_dynamics: Key = "object_dynamics"
    """`[..., 4]`: mass [kg], friction and centre of mass (x, y) in the object's frame."""
    subgoal_pose: Key = "subgoal_pose"
    """`[..., 3]` (x, y, yaw) on the planned path of the object's pose; the yaw continues the object's."""
    pose_path_ahead: Key = "pose_path_ahead"
    """`[..., n, 3]`: poses along that path."""
    pose_path_length: Key = "pose_path_length"
    """`[..., 1]`: cost of that path [m]."""
    history: Key = "history"
    """`[..., 8, 10]`: last steps in which the object was touched or moved, see `PushHistory`."""
    latent: Key = "latent"
    """`[..., d]`."""
    last_action: Key = "last_action"
    """`[..., 3]`; written by `PushObservation` if an entry reads it."""


class ObservationInputs:
    """Inputs of an entry of the observation.

    The attributes are quantities of the pushing task in the agent's frame, whose origin is the
    object's centre. Any other key of the tensordict is read unchanged by indexing:
    `inputs["my_key"]`, `inputs["group", "my_key"]`. Nothing is read or computed before an entry
    uses it.

    Args:
        tensordict: The tensordict to observe.
        frame: The agent's axes.
        keys: Key of each quantity, by its default name.
        bounds: Lower and upper corner of the area in which the object may be, base frame, `[2]`
            each [m].
        symmetry: Number of yaw angles at which every object is taken to look the same, instead of
            each object's own number.
    """

    object_pose: Tensor
    """The object's pose (x, y, yaw) in the base frame, `[..., 3]` [m, rad]."""
    ee_pose: Tensor
    """The tool tip's pose (x, y, yaw) in the base frame, `[..., 3]` [m, rad]."""
    joint_position: Tensor
    """Angles of the arm's joints, `[..., n]` [rad]."""
    path_length: Tensor
    """Length of the planned path from the object to the goal, `[..., 1]` [m]."""
    pose_path_length: Tensor
    """Cost of the planned path of poses to the goal pose, `[..., 1]` [m]."""
    object_radius: Tensor
    """Radius of the circle around the object's footprint, `[..., 1]` [m]."""
    latent: Tensor
    """The encoder's latent of the local window, `[..., d]`."""
    last_action: Tensor
    """The agent's last action, zeros after a reset, `[..., 3]`."""

    def __init__(
        self,
        tensordict: TensorDictBase,
        frame: Frame,
        keys: Mapping[str, NestedKey],
        bounds: tuple[Tensor, Tensor],
        symmetry: int | None = None,
    ) -> None:
        self._tensordict, self._frame, self._keys, self._bounds = tensordict, frame, keys, bounds
        self._symmetry = symmetry

    def __getitem__(self, key: NestedKey) -> Tensor:
        """The value under any key of the tensordict.

        Raises:
            KeyError: If there is none; the message lists the keys.
        """
        return read_key(self._tensordict, key)

    def _read(self, name: str) -> Tensor:
        return read_key(self._tensordict, self._keys[name], *_LAST.get(name, ()))

    def __getattr__(self, name: str) -> Tensor:
        """The quantities above, which are read as they are, once each."""
        if name not in ObservationInputs.__annotations__:
            raise AttributeError(f"ObservationInputs has no {name!r}.")
        value = self.__dict__[name] = self._read(name)
        return value

    @cached_property
    def object_position(self) -> Tensor:
        """The object's position in the base frame, `[..., 2]` [m]."""
        return self.object_pose[..., :2]

    @cached_property
    def frame_yaw(self) -> Tensor:
        """Angle of the agent's frame in the base frame, `[..., 1]` [rad]."""
        subgoal = self._read("subgoal") if self._frame == "path" else None
        return frame_yaw(self._frame, self.object_pose, subgoal)

    def to_frame(self, points: Tensor) -> Tensor:
        """Points of the base frame, `[..., 2]` [m], in the agent's frame."""
        return rotate(points - self.object_position, -self.frame_yaw)

    @property
    def ee_position(self) -> Tensor:
        """The tool tip's position, `[..., 2]` [m]."""
        return self.to_frame(self.ee_pose[..., :2])

    @property
    def ee_yaw(self) -> Tensor:
        """The tool's yaw, not wrapped, `[..., 1]` [rad]."""
        return self.ee_pose[..., 2:] - self.frame_yaw

    @property
    def object_yaw(self) -> Tensor:
        """The object's yaw, not wrapped, `[..., 1]` [rad]."""
        return self.object_pose[..., 2:] - self.frame_yaw

    @property
    def goal(self) -> Tensor:
        """The goal's position, `[..., 2]` [m]."""
        return self.to_frame(self._read("goal_position"))

    @property
    def goal_yaw(self) -> Tensor:
        """Yaw of the goal pose, not wrapped, `[..., 1]` [rad]."""
        return self._read("goal_pose")[..., 2:] - self.frame_yaw

    @property
    def yaw_error(self) -> Tensor:
        """Angle by which the object is to be turned, modulo its symmetry, `[..., 1]` [rad]."""
        return self._read("pose_error")[..., 1:]

    @property
    def subgoal(self) -> Tensor:
        """The present sub-goal's position, `[..., 2]` [m]."""
        return self.to_frame(self._read("subgoal"))

    @property
    def subgoal_past(self) -> Tensor:
        """Sub-goals of earlier steps, in the present frame, `[..., lags, 2]` [m]."""
        past = self._read("subgoal_past") - self.object_position.unsqueeze(-2)
        return rotate(past, -self.frame_yaw.unsqueeze(-2))

    @property
    def path_ahead(self) -> Tensor:
        """Points farther along the planned path, `[..., n, 2]` [m]."""
        ahead = self._read("path_ahead") - self.object_position.unsqueeze(-2)
        return rotate(ahead, -self.frame_yaw.unsqueeze(-2))

    @property
    def subgoal_pose(self) -> Tensor:
        """Sub-goal on the planned path of poses: position, and turn from here, `[..., 3]` [m, rad]."""
        pose = self._read("subgoal_pose")
        return torch.cat(
            [self.to_frame(pose[..., :2]), pose[..., 2:] - self.object_pose[..., 2:]], -1
        )

    @property
    def turns_ahead(self) -> Tensor:
        """Turns from here to poses along the planned path of poses, `[..., n]` [rad]."""
        return self._read("pose_path_ahead")[..., 2] - self.object_pose[..., 2:]

    @property
    def contact(self) -> Tensor:
        """1 where the tool touches the object, else 0, `[..., 1]`."""
        return self._read("object_contact").float()

    @property
    def object_symmetry(self) -> Tensor:
        """Number of yaw angles at which the object looks the same, 0 for all angles, `[..., 1]`."""
        if self._symmetry is not None:
            return torch.full_like(self.object_pose[..., :1], self._symmetry)
        return self._read("object_symmetry")

    def support(self, count: int) -> Tensor:
        """Reach of the object's footprint from its centre in `count` directions, `[..., count]` [m].

        The first direction is the frame's x, the others follow counter-clockwise at equal angles. Between
        the directions that are known it is interpolated.
        """
        known = self._read("object_support")
        step = 2 * math.pi / known.shape[-1]
        directions = torch.arange(count, dtype=torch.float32, device=known.device)
        directions = directions * (2 * math.pi / count)
        place = torch.remainder((directions - self.object_yaw) / step, known.shape[-1])
        below = place.floor().clamp(max=known.shape[-1] - 1)
        above = torch.remainder(below + 1, known.shape[-1])
        near, far = (known.gather(-1, index.long()) for index in (below, above))
        return near + (place - below) * (far - near)

    @property
    def obstacle_motion(self) -> Tensor:
        """Place [m] and velocity [m/s] of the nearest moving obstacle, `[..., 4]`; zeros for none."""
        place, velocity = self._read("obstacle_motion").split(2, -1)
        moves = velocity.any(-1, keepdim=True)
        return torch.cat([self.to_frame(place), rotate(velocity, -self.frame_yaw)], -1) * moves

    @property
    def object_dynamics(self) -> Tensor:
        """Mass as its binary logarithm, friction, and centre of mass (x, y) [m], `[..., 4]`."""
        mass, friction, center = self._read("object_dynamics").split((1, 1, 2), -1)
        return torch.cat([mass.log2(), friction, rotate(center, self.object_yaw)], -1)

    @property
    def history(self) -> Tensor:
        """Steps in which the object was touched or moved, see `PushHistory`, `[..., 8, 10]`."""
        vectors, others = self._read("history").split((8, 2), -1)
        turned = rotate(vectors.unflatten(-1, (4, 2)), self.object_yaw[..., None, None])
        return torch.cat([turned.flatten(-2), others], -1)

    @property
    def bounds(self) -> tuple[Tensor, Tensor]:
        """Corners of the area in which the object may be, base frame, `[2]` each [m]."""
        low, high = self._bounds
        return low.to(self.object_pose), high.to(self.object_pose)

    @property
    def frame_axes(self) -> Tensor:
        """Directions ahead, left, behind and right of the agent's frame, base frame, `[..., 4, 2]`."""
        ahead = torch.cat([self.frame_yaw.cos(), self.frame_yaw.sin()], -1)
        left = torch.stack([-ahead[..., 1], ahead[..., 0]], -1)
        return torch.stack([ahead, left, -ahead, -left], -2)
