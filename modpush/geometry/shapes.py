"""Solid primitives: the one description that physics, both cameras and the scene sampler share."""

import functools
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

__all__ = ["KINDS", "Kind", "Primitive", "box", "capsule", "cylinder", "prism", "rpy_matrix"]

Kind = Literal["box", "cylinder", "capsule", "prism"]
KINDS: tuple[Kind, ...] = ("box", "cylinder", "capsule", "prism")


@dataclass(frozen=True, kw_only=True)
class Primitive:
    """A solid in the frame of the body it belongs to.

    Axes: a cylinder, a capsule and a prism stand along their own z.
    """

    kind: Kind
    size: tuple[float, float, float]
    """[m] box and prism: half extents (a prism's about its origin); cylinder, capsule: radius, half
    length, 0."""
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Centre in the body's frame [m]."""
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Fixed-axis roll, pitch, yaw in the body's frame [rad], as in URDF."""
    outline: tuple[tuple[float, float], ...] = ()
    """Prism only: convex outline, counter-clockwise [m]."""
    color: tuple[float, float, float] = (0.6, 0.6, 0.6)
    """Seen by the rendered camera only."""

    def rotation(self) -> NDArray[np.float64]:
        """Rotation from the primitive's axes to the body's, `[3, 3]`."""
        return rpy_matrix(self.rpy)


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


_Vector = tuple[float, float, float]
_ZERO: _Vector = (0.0, 0.0, 0.0)
_GREY: _Vector = (0.6, 0.6, 0.6)


def box(
    length: float, width: float, height: float, position: _Vector = _ZERO, color: _Vector = _GREY
) -> Primitive:
    """A box of full extents [m] along x, y and z."""
    return Primitive(
        kind="box", size=(length / 2, width / 2, height / 2), position=position, color=color
    )


def cylinder(
    radius: float,
    length: float,
    position: _Vector = _ZERO,
    rpy: _Vector = _ZERO,
    color: _Vector = _GREY,
) -> Primitive:
    """A cylinder of full length [m] along its z."""
    return Primitive(
        kind="cylinder", size=(radius, length / 2, 0.0), position=position, rpy=rpy, color=color
    )


def capsule(
    radius: float,
    length: float,
    position: _Vector = _ZERO,
    rpy: _Vector = _ZERO,
    color: _Vector = _GREY,
) -> Primitive:
    """A capsule; `length` [m] is that of its cylindrical part."""
    return Primitive(
        kind="capsule", size=(radius, length / 2, 0.0), position=position, rpy=rpy, color=color
    )


def prism(
    outline: tuple[tuple[float, float], ...], height: float, color: _Vector = _GREY
) -> Primitive:
    """An upright prism over a convex, counter-clockwise outline [m]."""
    half_x, half_y = (max(abs(vertex[axis]) for vertex in outline) for axis in (0, 1))
    return Primitive(kind="prism", size=(half_x, half_y, height / 2), outline=outline, color=color)
