"""`Robot` and `Tool` as data: all that physics, cameras, control and the page know of an arm."""

import math
from collections.abc import Callable
from functools import cached_property
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Strict
from pydantic_core import PydanticCustomError

from modpush._types import (
    Angle,
    Angles,
    AtLeastOne,
    Length,
    LengthSpan,
    Name,
    NonNegativeLength,
    Position,
    Positive,
    Several,
)
from modpush._validation import checked
from modpush.geometry.shapes import Primitive, rpy_matrix

InverseKinematics = Callable[
    [NDArray[np.float64], NDArray[np.float64]], tuple[NDArray[np.float64], NDArray[np.bool_]]
]
"""`solve(pose, last) -> (joints, found)`, batched.

`pose` `[N, 4]` is x, y, z of the flange [m] and its yaw [rad], which need not be wrapped, in the frame of
the arm's base; the flange points straight down. `last` `[N, n]` are joint angles nearby [rad], to which
the solution should be close. `joints` `[N, n]` are finite also where `found` `[N]` is False.
"""


_OTHER_BODIES = ["tool", "tip", "object"]
_MOST_TURNED = 4 * math.pi  # by a joint; a larger number is in degrees [rad]
_POSE_JOINTS = 6  # that reach a position and an orientation
_ROUNDING = 1e-6  # of an axis' length


def _urdf_kinds(shapes: tuple[Primitive, ...]) -> tuple[Primitive, ...]:
    if any(shape.kind == "prism" for shape in shapes):  # which a URDF does not know
        raise PydanticCustomError("kind", "Input should be boxes, cylinders and capsules")
    return shapes


_Shapes = Annotated[AtLeastOne[Primitive], AfterValidator(_urdf_kinds)]


@checked
class Link:
    """A link of an arm; its frame is that of the joint before it."""

    name: Name
    mass: Positive
    """Mass [kg]."""
    shapes: _Shapes
    """Solids that collide and are drawn: boxes, cylinders and capsules."""


@checked
class Joint:
    """A joint between a link and the next one, which turns about an axis through its frame's origin."""

    name: Name
    limits: Annotated[tuple[Angle, Angle], Strict(False)]
    """Smallest and largest angle [rad]."""
    effort: Positive
    """Largest torque of the drive [N m]."""
    position: Position = (0.0, 0.0, 0.0)
    """Origin of its frame in that of the link before it [m]."""
    rpy: Angles = (0.0, 0.0, 0.0)
    """Fixed-axis roll, pitch, yaw of its frame in that of the link before it [rad], as in URDF."""
    axis: Position = (0.0, 0.0, 1.0)
    """Its axis in its frame, of length 1, as in URDF; by default the frame's z axis."""

    def __post_init__(self) -> None:
        if abs(math.hypot(*self.axis) - 1) > _ROUNDING:
            raise ValueError(f"Joint {self.name!r}: axis must be of length 1, got {self.axis}.")
        low, high = self.limits
        if max(abs(low), abs(high)) > _MOST_TURNED:
            raise ValueError(
                f"Joint {self.name!r}: limits must be in radians and within two turns, +-12.57, got "
                f"{self.limits}; math.radians converts degrees."
            )
        if not low < high:
            raise ValueError(
                f"Joint {self.name!r}: limits must be (smallest, largest), got {self.limits}."
            )


@checked
class Tool:
    """A tool that is mounted on the flange; its frame's z axis points out of the flange."""

    name: Name
    mass: Positive
    """Mass [kg]."""
    length: Length
    """Distance from the flange to the tip [m]."""
    tip_half_extents: Annotated[tuple[Length, Length], Strict(False)]
    """Half the footprint of the tip along the tool's x and y [m]."""
    shapes: _Shapes
    """Solids that collide and are drawn: boxes, cylinders and capsules."""
    half_turn: bool = False
    """It looks the same after half a turn, so that an arm may hold it either way."""


@checked
class Room:
    """Distances that obstacles keep from the axis of an arm's base, so that no link stands in them."""

    radius: Length
    """Distance of low obstacles [m]."""
    height: NonNegativeLength = 0.0
    """Height up to which obstacles are low [m]."""
    slope: NonNegativeLength = 0.0
    """Increase of the distance per metre of further height."""

    def distance(self, height: float) -> float:
        """Distance that an obstacle of a height keeps [m]."""
        return self.radius + self.slope * max(0.0, height - self.height)


class Chain(NamedTuple):
    """The joints of an arm as arrays, their frames turned such that each joint turns about its z axis."""

    frames: NDArray[np.float64]
    """Frame of each joint in that of the joint before it, and the flange's, `[n + 1, 4, 4]`."""
    limits: NDArray[np.float64]
    """`[n, 2]` [rad]."""
    home: NDArray[np.float64]
    """`[n]` [rad]."""


@checked
class Robot:
    """An arm whose joints all turn, standing on the table, as data.

    Raises:
        ValueError: If the numbers of links, joints and home angles do not fit together, a name is given
            twice, home is outside of the limits, or there are fewer than six joints and no `solve`.
    """

    name: Name
    links: AtLeastOne[Link]
    """The links from the base, which does not move, to the last one; one more than joints."""
    joints: AtLeastOne[Joint]
    """The joints from base to flange."""
    home: Several[Angle]
    """Angles of the joints with the tool down over the middle of the workspace [rad]. An arm with more
    joints than it needs is drawn back to them, but for its first and last joint, and every start is
    sought on the way from there."""
    reach: LengthSpan
    """Smallest and largest distance from the axis of the base at which the tool can work [m]."""
    flange_position: Position = (0.0, 0.0, 0.0)
    """Origin of the flange in the last link's frame [m]."""
    flange_rpy: Angles = (0.0, 0.0, 0.0)
    """Fixed-axis roll, pitch, yaw of the flange there [rad]; its z axis points out of it."""
    base: Position = (0.0, 0.0, 0.0)
    """Place of the arm's base in the base frame [m], in which the workspace lies."""
    room: Room | None = None
    """Distance of obstacles from the base; None measures it from the links."""
    stiffness: Positive = 2e4
    """Stiffness of the joint drives [N m/rad]."""
    damping: Positive = 5e2
    """Damping of the joint drives [N m s/rad]. With velocity targets it causes no lag."""
    solve: Any = None
    """Inverse kinematics, an `InverseKinematics`; None takes `DampedLeastSquares`, for any arm."""

    def __post_init__(self) -> None:
        n = len(self.joints)
        if (len(self.links), len(self.home)) != (n + 1, n):
            raise ValueError(
                f"Robot {self.name!r}: {n} joints need {n + 1} links and {n} home angles, got "
                f"{len(self.links)} and {len(self.home)}."
            )
        for kind, names in (
            ("links", [*(link.name for link in self.links), *_OTHER_BODIES]),
            ("joints", [joint.name for joint in self.joints]),
        ):
            if repeated := sorted({name for name in names if names.count(name) > 1}):
                raise ValueError(
                    f"Robot {self.name!r}: {kind} must have different names, and no link one of "
                    f"{_OTHER_BODIES}, got {repeated} several times."
                )
        for joint, angle in zip(self.joints, self.home, strict=True):
            low, high = joint.limits
            if not low <= angle <= high:
                raise ValueError(
                    f"Robot {self.name!r}: home of {joint.name!r} must be within its limits "
                    f"{joint.limits}, got {angle}."
                )
        if n < _POSE_JOINTS and self.solve is None:
            raise ValueError(
                f"Robot {self.name!r}: {_POSE_JOINTS} joints or more are needed to hold the tool down at "
                f"any place and yaw, got {n}. An arm with fewer needs a solve of its own."
            )
        if not self.reach[0] < self.reach[1]:
            raise ValueError(f"Robot {self.name!r}: reach must be (least, most), got {self.reach}.")
        if not (self.solve is None or callable(self.solve)):
            raise ValueError(
                f"Robot {self.name!r}: solve must be a function (pose, last) -> (joints, found), or "
                f"None, got {self.solve!r}."
            )

    @cached_property
    def inverse(self) -> InverseKinematics:
        """The inverse kinematics: `solve`, or the numerical one."""
        from modpush.envs.robot.least_squares import DampedLeastSquares

        return DampedLeastSquares(self.chain) if self.solve is None else self.solve

    @cached_property
    def chain(self) -> Chain:
        """The joints as arrays."""
        places = [(joint.position, joint.rpy) for joint in self.joints]
        places.append((self.flange_position, self.flange_rpy))
        frames = np.tile(np.eye(4), (len(places), 1, 1))
        turns = [np.eye(3), *self._turns, np.eye(3)]
        for i, (frame, (position, rpy)) in enumerate(zip(frames, places, strict=True)):
            frame[:3, :3] = turns[i].T @ rpy_matrix(rpy) @ turns[i + 1]
            frame[:3, 3] = turns[i].T @ position
        limits = np.array([joint.limits for joint in self.joints])
        return Chain(frames, limits, np.array(self.home))

    @cached_property
    def _turns(self) -> list[NDArray[np.float64]]:
        """For each joint the rotation that takes z to its axis, `[3, 3]`."""
        return [_turn_of_z(joint.axis) for joint in self.joints]

    def link_transforms(self, joints: NDArray[np.float64]) -> NDArray[np.float64]:
        """Transforms of the links, then of the flange, on which the tool is mounted.

        Args:
            joints: Angles of the joints, `[..., n]` [rad].

        Returns:
            `[..., n + 2, 4, 4]` in the base frame.
        """
        joints = np.asarray(joints)
        transform = np.tile(np.eye(4), (*joints.shape[:-1], 1, 1))
        transform[..., :3, 3] = self.base
        found = [transform]
        angles = np.moveaxis(joints, -1, 0)
        for frame, angle, of_z in zip(self.chain.frames, angles, self._turns, strict=False):
            turn = np.tile(np.eye(4), (*angle.shape, 1, 1))
            turn[..., 0, 0], turn[..., 0, 1] = np.cos(angle), -np.sin(angle)
            turn[..., 1, 0], turn[..., 1, 1] = np.sin(angle), np.cos(angle)
            transform = transform @ frame @ turn
            link = transform.copy()
            link[..., :3, :3] = transform[..., :3, :3] @ of_z.T
            found.append(link)
        return np.stack([*found, transform @ self.chain.frames[-1]], -3)

    def tip_transform(self, joints: NDArray[np.float64], tool: Tool) -> NDArray[np.float64]:
        """Transform of a tool's tip, `[..., 4, 4]` in the base frame; z points out of the flange."""
        transform: NDArray[np.float64] = self.link_transforms(joints)[..., -1, :, :]
        transform[..., :3, 3] += tool.length * transform[..., :3, 2]
        return transform


def _turn_of_z(axis: tuple[float, float, float]) -> NDArray[np.float64]:
    """The smallest rotation that takes z to an axis of length 1, `[3, 3]`."""
    x, y, z = axis
    if z < -1 + _ROUNDING:
        return np.diag([1.0, -1.0, -1.0])
    cross = np.array([[0.0, 0.0, x], [0.0, 0.0, y], [-x, -y, 0.0]])  # z times the axis, as a matrix
    return np.eye(3) + cross + cross @ cross / (1 + z)
