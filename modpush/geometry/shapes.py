"""Solid primitives, which physics, depth cameras and the scene sampler share."""

import functools
import math
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from modpush._types import Angles, Color, Extents, Length, Point, Position, Several
from modpush._validation import checked, checked_arguments

Kind = Literal["box", "cylinder", "capsule", "prism"]
KINDS: tuple[Kind, ...] = ("box", "cylinder", "capsule", "prism")


@checked
class Primitive:
    """A solid in the frame of its body; see `box`, `cylinder`, `capsule`, `prism`.

    A cylinder, a capsule and a prism stand along their own z axis.

    Raises:
        ValueError: If a size is not positive, a number is not finite, the kind is unknown, or a
            prism's outline is not convex and counter-clockwise or has other half extents.
    """

    kind: Kind
    """Kind of solid."""
    size: Extents
    """Half extents of a box and of a prism (about its origin); radius, half length and 0 of a cylinder
    and of a capsule [m]."""
    position: Position = (0.0, 0.0, 0.0)
    """Centre in the body's frame [m]."""
    rpy: Angles = (0.0, 0.0, 0.0)
    """Fixed-axis roll, pitch, yaw in the body's frame [rad], as in URDF."""
    outline: Several[Point] = ()
    """Prism only: convex outline, counter-clockwise [m]."""
    color: Color = (0.6, 0.6, 0.6)
    """Red, green and blue in [0, 1], used in rendered images only."""

    def __post_init__(self) -> None:
        sizes = self.size if self.kind in ("box", "prism") else self.size[:2]
        if not min(sizes) > 0:
            raise ValueError(f"Primitive: the sizes of a {self.kind} must be > 0, got {sizes}.")
        if self.kind == "prism":
            _check_outline(self.outline)
            extents = _half_extents(self.outline)
            if not np.allclose(self.size[:2], extents, rtol=1e-6, atol=1e-9):
                raise ValueError(
                    f"Primitive: the first two sizes of a prism must be its outline's half extents "
                    f"{extents}, got {self.size[:2]}; `prism` takes them from the outline."
                )

    def rotation(self) -> NDArray[np.float64]:
        """Rotation from the primitive's axes to the body's, `[3, 3]`."""
        return rpy_matrix(self.rpy)


def _half_extents(outline: tuple[tuple[float, float], ...]) -> tuple[float, float]:
    """Largest distances from the origin along x and y [m]."""
    half_x, half_y = (max(abs(vertex[axis]) for vertex in outline) for axis in (0, 1))
    return half_x, half_y


def _check_outline(outline: tuple[tuple[float, float], ...]) -> None:
    """Raise unless an outline is convex and counter-clockwise."""
    if len(outline) < 3:
        raise ValueError(f"Primitive: the outline of a prism needs 3 corners, got {outline}.")
    corners = np.array(outline)
    edge = np.roll(corners, -1, axis=0) - corners
    following = np.roll(edge, -1, axis=0)
    cross = edge[:, 0] * following[:, 1] - edge[:, 1] * following[:, 0]
    turns = np.arctan2(cross, (edge * following).sum(1))
    if not (turns > 0).all() or abs(turns.sum() - 2 * math.pi) > 1e-6:
        raise ValueError(
            "Primitive: the outline of a prism must be convex and counter-clockwise, without corners "
            f"in line, got {outline}. Compose a body that is not convex of several parts."
        )


@functools.cache
def rpy_matrix(rpy: tuple[float, float, float]) -> NDArray[np.float64]:
    """Rotation matrix `[3, 3]` of fixed-axis roll, pitch, yaw [rad]; read-only."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    matrix = np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
    matrix.setflags(write=False)
    return matrix


_ZERO: Position = (0.0, 0.0, 0.0)
_GREY: Color = (0.6, 0.6, 0.6)


@checked_arguments
def box(
    length: Length, width: Length, height: Length, position: Position = _ZERO, color: Color = _GREY
) -> Primitive:
    """A box of full extents [m] along x, y and z."""
    return Primitive(
        kind="box",
        size=(length / 2, width / 2, height / 2),
        position=position,
        color=color,
    )


@checked_arguments
def cylinder(
    radius: Length,
    length: Length,
    position: Position = _ZERO,
    rpy: Angles = _ZERO,
    color: Color = _GREY,
) -> Primitive:
    """A cylinder of full length [m] along its z."""
    return Primitive(
        kind="cylinder",
        size=(radius, length / 2, 0.0),
        position=position,
        rpy=rpy,
        color=color,
    )


@checked_arguments
def capsule(
    radius: Length,
    length: Length,
    position: Position = _ZERO,
    rpy: Angles = _ZERO,
    color: Color = _GREY,
) -> Primitive:
    """A capsule; `length` [m] is that of its cylindrical part."""
    return Primitive(
        kind="capsule",
        size=(radius, length / 2, 0.0),
        position=position,
        rpy=rpy,
        color=color,
    )


@checked_arguments
def prism(
    outline: Several[Point],
    height: Length,
    position: Position = _ZERO,
    color: Color = _GREY,
) -> Primitive:
    """An upright prism of full height [m] over a convex, counter-clockwise outline [m]."""
    _check_outline(outline)
    return Primitive(
        kind="prism",
        size=(*_half_extents(outline), height / 2),
        position=position,
        outline=outline,
        color=color,
    )
