"""The entries of which an observation is made."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from operator import attrgetter

import torch
from torch import Tensor

from modpush._types import Finite, Several
from modpush._validation import check_value
from modpush.geometry.frames import wrap_angle
from modpush.mdp.observation_inputs import ObservationInputs
from modpush.mdp.push_history import HISTORY_STEPS

_Components = Finite | Several[Finite]


@dataclass(frozen=True)
class Entry:
    """One entry of the observation: what it reads, and how it is scaled to order 1."""

    read: Callable[[ObservationInputs], Tensor]
    """`ObservationInputs -> [..., n]`, in SI units."""
    scale: float | tuple[float, ...] = 1.0
    """Factor applied after the shift, one number or one for each component."""
    shift: float | tuple[float, ...] | Callable[[], Tensor] = 0.0
    """Value that is subtracted, one number or one for each component; or a function that returns it,
    which is called for every observation and returns the same tensor as long as nothing changes."""
    mirrored: Callable[[ObservationInputs], Tensor] | tuple[float, ...] | None = None
    """`ObservationInputs -> [..., n]`: what `read` would give in the scene mirrored at the x axis of the
    agent's frame, in SI units; or the sign that each component has there, one for all or one for each;
    None if that is not known, as for the arm's joints. The latent that it reads is that of the mirrored
    window."""

    def __post_init__(self) -> None:
        if not callable(self.read):
            raise TypeError(f"Entry: read must be a function, got {self.read!r}.")
        if not (self.mirrored is None or callable(self.mirrored)):
            check_value("mirrored", self.mirrored, Several[Finite])
        check_value("scale", self.scale, _Components)
        if not callable(self.shift):
            check_value("shift", self.shift, _Components)


EntryLike = str | Entry | Callable[[ObservationInputs], Tensor]
"""An entry: a name in `ENTRIES`, `"module:name"`, an `Entry`, or a plain function with scale 1."""


def _ee_pose(inputs: ObservationInputs) -> Tensor:
    yaw = inputs.ee_yaw
    level = torch.zeros_like(yaw)  # pitch and roll: the controller keeps the tool pointing down
    return torch.cat([inputs.ee_position, wrap_angle(yaw), level, level], -1)


def _ee_axis(inputs: ObservationInputs) -> Tensor:
    angle = 2.0 * inputs.ee_yaw  # the closed gripper looks the same from both sides
    return torch.cat([angle.cos(), angle.sin()], -1)


def _subgoal_past(inputs: ObservationInputs) -> Tensor:
    return inputs.subgoal_past.flatten(-2)


def _goal_distance(inputs: ObservationInputs) -> Tensor:
    return inputs.goal.norm(dim=-1, keepdim=True)


def _goal_distance_fine(inputs: ObservationInputs) -> Tensor:
    return torch.tanh(_FINE * _goal_distance(inputs))


def _yaw_error(inputs: ObservationInputs) -> Tensor:
    angle = inputs.object_symmetry.clamp_min(1) * inputs.yaw_error
    return torch.cat([angle.cos(), angle.sin()], -1)


def _goal_axis(inputs: ObservationInputs) -> Tensor:
    angle = inputs.object_symmetry * inputs.goal_yaw
    return torch.cat([angle.cos(), angle.sin()], -1)


def _object_axis(inputs: ObservationInputs) -> Tensor:
    angle = inputs.object_symmetry * inputs.object_yaw
    return torch.cat([angle.cos(), angle.sin()], -1)


def _path_ahead(inputs: ObservationInputs) -> Tensor:
    return inputs.path_ahead.flatten(-2)


def _edges(inputs: ObservationInputs) -> Tensor:
    # Along each axis as far as the edge, whichever of the two edges in its way is met first.
    low, high = inputs.bounds
    axes = inputs.frame_axes
    position = inputs.object_position.unsqueeze(-2)
    room = torch.where(axes > 0, high - position, position - low)
    distance = (room / axes.abs().clamp_min(1e-6)).amin(-1)
    return (_EDGE_RANGE - distance).clamp(0.0, _EDGE_RANGE)


def _object_support(inputs: ObservationInputs) -> Tensor:
    return inputs.support(8)


def _history(inputs: ObservationInputs) -> Tensor:
    return inputs.history.flatten(-2)


def _mirrored_points(points: Tensor) -> Tensor:
    return (points * points.new_tensor([1.0, -1.0])).flatten(-2)


def _mirrored_subgoal_past(inputs: ObservationInputs) -> Tensor:
    return _mirrored_points(inputs.subgoal_past)


def _mirrored_path_ahead(inputs: ObservationInputs) -> Tensor:
    return _mirrored_points(inputs.path_ahead)


def _mirrored_edges(inputs: ObservationInputs) -> Tensor:
    return _edges(inputs)[..., [0, 3, 2, 1]]  # left and right change places


def _mirrored_object_support(inputs: ObservationInputs) -> Tensor:
    return _object_support(inputs)[..., [0, 7, 6, 5, 4, 3, 2, 1]]


# The arm's joints with its tool over the middle of the workspace [rad], and the inverse of how far the
# tool's places on the table turn each of them. The fifth keeps the tool pointing down.
_HOME = (0.2, -1.75, -1.9, -1.05, math.pi / 2, -1.35)
_JOINT_SCALE = (1.5, 2.0, 1.5, 5.0, 1.0, 1.0)

# Inverse of the distance from the goal over which the entry `goal_distance_fine` resolves [1/m].
_FINE = 25.0

# Of the values of a remembered step: tip, action, motion of tip and of object, turn, contact.
_HISTORY_SCALE = (10.0, 10.0, 1.0, 1.0, 50.0, 50.0, 50.0, 50.0, 10.0, 1.0)
_HISTORY_SIGNS = (1, -1, 1, -1, 1, -1, 1, -1, -1, 1)

# Distance at which the edge of the workspace begins to show [m].
_EDGE_RANGE = 0.15

_SAME = (1.0,)  # signs of what is the same in the mirrored scene

ENTRIES: dict[str, Entry] = {
    "latent": Entry(attrgetter("latent"), mirrored=_SAME),
    "ee_pose": Entry(_ee_pose, (10.0, 10.0, 1.0 / math.pi, 1.0, 1.0), mirrored=(1, -1, -1, 1, 1)),
    "ee_position": Entry(attrgetter("ee_position"), 10.0, mirrored=(1, -1)),
    "ee_axis": Entry(_ee_axis, mirrored=(1, -1)),
    "joint_position": Entry(attrgetter("joint_position"), _JOINT_SCALE, _HOME),
    "subgoal_past": Entry(_subgoal_past, 5.0, mirrored=_mirrored_subgoal_past),
    "path_ahead": Entry(_path_ahead, 5.0, mirrored=_mirrored_path_ahead),
    "contact": Entry(attrgetter("contact"), mirrored=_SAME),
    "goal_distance": Entry(_goal_distance, 3.0, mirrored=_SAME),
    "goal_distance_fine": Entry(_goal_distance_fine, mirrored=_SAME),
    "goal_axis": Entry(_goal_axis, mirrored=(1, -1)),
    "yaw_error": Entry(_yaw_error, mirrored=(1, -1)),
    "object_axis": Entry(_object_axis, mirrored=(1, -1)),
    "goal": Entry(attrgetter("goal"), 3.0, mirrored=(1, -1)),
    "subgoal": Entry(attrgetter("subgoal"), 5.0, mirrored=(1, -1)),
    "path_length": Entry(attrgetter("path_length"), 3.0, mirrored=_SAME),
    "subgoal_pose": Entry(attrgetter("subgoal_pose"), (5.0, 5.0, 1.0), mirrored=(1, -1, -1)),
    "turns_ahead": Entry(attrgetter("turns_ahead"), mirrored=(-1,)),
    "pose_path_length": Entry(attrgetter("pose_path_length"), 3.0, mirrored=_SAME),
    "edges": Entry(_edges, 1.0 / _EDGE_RANGE, mirrored=_mirrored_edges),
    "object_radius": Entry(attrgetter("object_radius"), 100.0, 0.04, mirrored=_SAME),
    "object_symmetry": Entry(attrgetter("object_symmetry"), 0.5, 2.0, mirrored=_SAME),
    "object_support": Entry(_object_support, 50.0, 0.035, mirrored=_mirrored_object_support),
    "last_action": Entry(attrgetter("last_action"), mirrored=(1, -1, -1)),
    "obstacle_motion": Entry(
        attrgetter("obstacle_motion"), (5.0, 5.0, 10.0, 10.0), mirrored=(1, -1, 1, -1)
    ),
    "object_dynamics": Entry(
        attrgetter("object_dynamics"),
        (0.5, 2.0, 50.0, 50.0),
        (0.0, 0.5, 0.0, 0.0),
        mirrored=(1, 1, 1, -1),
    ),
    "history": Entry(
        _history, _HISTORY_SCALE * HISTORY_STEPS, mirrored=_HISTORY_SIGNS * HISTORY_STEPS
    ),
}
"""The entries that the library brings, by name. `ee_pose` is (x, y, yaw, pitch, roll). `ee_axis` and
`object_axis` are the cosine and sine of the yaw times the symmetry of gripper and object. `goal_axis`
and `yaw_error` are the same of a goal pose's yaw and of the angle by which the object is to be turned,
for environments with `goal="pose"`. `goal_distance_fine` is the hyperbolic tangent of the distance in
units of 4 cm. `edges` says by how much the edge of the workspace, past which an episode ends, is nearer
than 15 cm, straight ahead, left, behind and right of the object: 0 to 0.15 m. `object_support` is how far
the object reaches in eight directions, the first along the frame's x: its shape, size and yaw, whatever
its symmetry.
`path_ahead` needs `PlannerSubgoals(ahead=...)`, and `obstacle_motion`, place and velocity of the nearest
obstacle that moves by itself, `PushEnv(obstacle_motion=True)`. `object_dynamics` tells mass, friction and
centre of mass, and needs `PushEnv(object_dynamics=True)`. `history` is what the object did when it was
pushed before, and needs `PushHistory`, which `make_push_env` adds for it. `subgoal_pose` (x, y and the
turn to it), `turns_ahead` and `pose_path_length` are of the planned path of poses,
`PoseSubgoals(ahead=...)`."""

PAPER_ENTRIES = (
    "latent",
    "ee_pose",
    "joint_position",
    "subgoal_past",
    "contact",
    "goal_distance",
)
"""The 49 values of the paper's table of observations (Sec. IV-B), with a latent of 32."""

PATH_ENTRIES = (
    "latent",
    "ee_position",
    "ee_axis",
    "joint_position",
    "subgoal_past",
    "contact",
    "goal_distance",
    "path_length",
    "object_axis",
    "edges",
)
"""The entries for `frame="path"`: the object's own yaw, the length of the path, which the reward depends
on, and the workspace's edges are added, and angles are smooth; 55 values with a latent of 32."""

PATH_AHEAD_ENTRIES = (
    *(name for name in PATH_ENTRIES if name != "joint_position"),
    "path_ahead",
)
"""The same without the arm's joints, so that the observation can be mirrored, and with points farther
along the path, which show where it turns; 55 values with a latent of 32 and three points."""

POSE_ENTRIES = (*PATH_AHEAD_ENTRIES, "goal_distance_fine", "goal_axis", "yaw_error")
"""The same for goal poses; 60 values with a latent of 32 and three points."""
