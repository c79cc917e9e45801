"""Universal Robots' arms, made from one table, and their inverse kinematics in closed form, compiled.

Source: Denavit-Hartenberg numbers, masses and limits as published by the maker. The solids are
cylinders and capsules around the links. The geometry of the solution is the textbook one for an arm with
three parallel axes and a wrist that does not intersect in a point.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from modpush._kernels import njit
from modpush.envs.robot.robot import Joint, Link, Robot, Room
from modpush.geometry.shapes import Primitive, capsule, cylinder

_GREY, _DARK, _BLUE = (0.72, 0.74, 0.76), (0.25, 0.26, 0.28), (0.35, 0.58, 0.78)
_SIDEWAYS = (0.0, math.pi / 2, 0.0)  # turns a capsule's z onto the link's x
_HALF, _TURN = math.pi, 2 * math.pi
_ALPHA = (math.pi / 2, 0.0, 0.0, math.pi / 2, -math.pi / 2, 0.0)
_JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
_LINKS = ("base", "shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")


class _Numbers(NamedTuple):
    """Link lengths and limits by which the arms differ."""

    d: tuple[float, float, float, float]
    """Denavit-Hartenberg offsets of joints 1, 4, 5 and 6 [m]; the others are 0."""
    a: tuple[float, float]
    """Lengths of upper arm and forearm, negative [m]."""
    aside: tuple[float, float]
    """Distance of upper arm and forearm from the plane through the base's axis [m]."""
    masses: tuple[float, float, float, float, float, float, float]
    """Masses of base, shoulder, upper arm, forearm and the wrist's three links [kg]."""
    efforts: tuple[float, float, float, float, float, float]
    """Largest torques [N m]."""
    girth: float
    """Thickness beside a UR5's."""
    reach: tuple[float, float]
    """See `Robot.reach`, with tools down to flange heights of 16 to 22 cm [m]."""
    base_x: float
    """Place of the base, such that the same workspace is within reach [m]."""
    room: Room | None = None


_TABLE = {
    "ur3": _Numbers(
        d=(0.1519, 0.11235, 0.08535, 0.0819),
        a=(-0.24365, -0.21325),
        aside=(0.1198, 0.0273),
        masses=(2.0, 2.0, 3.42, 1.26, 0.8, 0.8, 0.35),
        efforts=(56.0, 56.0, 28.0, 12.0, 12.0, 12.0),
        girth=0.8,
        reach=(0.16, 0.52),
        base_x=0.0,
    ),
    "ur5": _Numbers(
        d=(0.089159, 0.10915, 0.09465, 0.0823),
        a=(-0.425, -0.39225),
        aside=(0.13585, 0.01615),
        masses=(4.0, 3.7, 8.393, 2.275, 1.219, 1.219, 0.1879),
        efforts=(150.0, 150.0, 150.0, 28.0, 28.0, 28.0),
        girth=1.0,
        reach=(0.16, 0.885),
        base_x=0.0,
        # The shoulder turns within 0.2 m; of the inclined upper arm more comes down to greater heights.
        room=Room(radius=0.20, height=0.08, slope=1.75),
    ),
    "ur5e": _Numbers(
        d=(0.1625, 0.1333, 0.0997, 0.0996),
        a=(-0.425, -0.3922),
        aside=(0.138, 0.007),
        masses=(4.0, 3.761, 8.058, 2.846, 1.37, 1.3, 0.365),
        efforts=(150.0, 150.0, 150.0, 28.0, 28.0, 28.0),
        girth=1.0,
        reach=(0.18, 0.90),
        base_x=-0.02,
    ),
    "ur10": _Numbers(
        d=(0.1273, 0.163941, 0.1157, 0.0922),
        a=(-0.612, -0.5723),
        aside=(0.220941, 0.049041),
        masses=(4.0, 7.778, 12.93, 3.87, 1.96, 1.96, 0.202),
        efforts=(330.0, 330.0, 150.0, 56.0, 56.0, 56.0),
        girth=1.3,
        reach=(0.22, 1.27),
        base_x=-0.10,
    ),
}


@dataclass(frozen=True)
class ThreeParallelAxes:
    """Joint angles that hold the tool straight down at a pose, in the working branch.

    With the tool down the wrist's bend is a right angle and the last joint follows yaw linearly, so the
    solution is continuous over the whole workspace and in an unwrapped yaw: no branch is searched and
    none can be jumped. Of the arm's eight branches two keep the elbow over the table (25 cm and more on a
    UR5) and reach the whole workspace; this is the one whose shoulder angle does not wrap there. It is an
    `InverseKinematics`; poses out of reach get the angles of the nearest reach. `d` and `a` are the
    Denavit-Hartenberg offsets and lengths of the six joints [m].
    """

    d: tuple[float, ...]
    a: tuple[float, ...]

    def __call__(
        self, pose: NDArray[np.float64], last: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """See `InverseKinematics`; the solution does not depend on `last`."""
        if pose.ndim != 2 or pose.shape[1] != 4:
            raise ValueError(
                f"ThreeParallelAxes: pose must be [N, 4] (x, y, z, yaw), got {pose.shape}."
            )
        d1, _, _, d4, d5, d6 = self.d
        return _solve(pose, d1, self.a[1], self.a[2], d4, d5, d6)


@njit()
def _solve(
    pose: NDArray[np.float64],
    d1: float,
    a2: float,
    a3: float,
    d4: float,
    d5: float,
    d6: float,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    joints, found = np.empty((len(pose), 6)), np.empty(len(pose), np.bool_)
    for i in range(len(pose)):
        x, y, height, yaw = pose[i]
        q = joints[i]
        radius_sq = x * x + y * y
        lever = d4 / math.sqrt(max(radius_sq, 1e-12))
        q[0] = math.atan2(y, x) - math.acos(min(max(lever, -1.0), 1.0)) + math.pi / 2
        # How far the wrist is out along the arm's plane, less the offset of axis 5 that lies in it.
        r = math.sqrt(max(radius_sq - d4 * d4, 0.0)) - d5
        h = height + d6 - d1
        bend = (r * r + h * h - a2 * a2 - a3 * a3) / (2 * a2 * a3)
        q[2] = -math.acos(min(max(bend, -1.0), 1.0))
        q[1] = math.atan2(h, r) - math.atan2(a3 * math.sin(q[2]), a2 + a3 * math.cos(q[2]))
        q[3] = -1.5 * math.pi - q[1] - q[2]  # keeps axis 5 level, pointing outwards
        q[4] = math.pi / 2
        q[5] = q[0] - yaw - math.pi / 2
        within = abs(lever) <= 1 + 1e-9 and abs(bend) <= 1 + 1e-9  # forgives rounding errors
        found[i] = within and radius_sq > 1e-12 and abs(q[5]) <= 2 * math.pi
    return joints, found


def _robot(name: str, of: _Numbers) -> Robot:
    d1, d4, d5, d6 = of.d
    d, a = (d1, 0.0, 0.0, d4, d5, d6), (0.0, *of.a, 0.0, 0.0, 0.0)
    origins = [(0.0, 0.0, 0.0), *((a[i], 0.0, d[i]) for i in range(5))]
    joints = [
        Joint(
            name=joint,
            position=origin,
            rpy=(roll, 0.0, 0.0),
            limits=(-_HALF, _HALF) if joint == "elbow" else (-_TURN, _TURN),
            effort=effort,
        )
        for joint, origin, roll, effort in zip(
            _JOINTS, origins, (0.0, *_ALPHA), of.efforts, strict=False
        )
    ]
    links = [
        Link(name=link, mass=mass, shapes=shapes)
        for link, mass, shapes in zip(_LINKS, of.masses, _shapes(of), strict=True)
    ]
    return Robot(
        name=name,
        links=tuple(links),
        joints=tuple(joints),
        home=(0.2, -1.75, -1.9, -1.05, math.pi / 2, -1.35),
        reach=of.reach,
        flange_position=(0.0, 0.0, d6),
        base=(of.base_x, 0.0, 0.0),
        room=of.room,
        solve=ThreeParallelAxes(d, a),
    )


def _shapes(of: _Numbers) -> list[tuple[Primitive, ...]]:
    """The solids of each link."""
    g, (d1, d4, d5, d6), (upper, fore), (beside, forward) = of.girth, of.d, of.a, of.aside

    def tube(
        radius: float, length: float, x: float, z: float, color: tuple[float, ...]
    ) -> Primitive:
        place = (round(x, 6), 0.0, round(z, 6))
        red, green, blue = color
        return cylinder(radius * g, length * g, place, color=(red, green, blue))

    def bone(radius: float, length: float, z: float) -> Primitive:
        place = (length / 2, 0.0, z)
        return capsule(radius * g, -length, place, rpy=_SIDEWAYS, color=_GREY)

    return [
        (tube(0.075, 0.04, 0.0, 0.02 * g, _DARK),),
        (tube(0.06, 0.178, 0.0, d1, _GREY),),
        (
            tube(0.06, 0.13, 0.0, beside - 0.01085 * g, _BLUE),
            bone(0.052, upper, beside),
            tube(0.055, 0.13, upper, beside - 0.01085 * g, _BLUE),
        ),
        (bone(0.042, fore, forward), tube(0.045, 0.10, fore, forward + 0.00385 * g, _BLUE)),
        (tube(0.0375, 0.12, 0.0, d4 - 0.00915 * g, _GREY),),
        (tube(0.0375, 0.11, 0.0, d5 - 0.00965 * g, _BLUE),),
        (tube(0.0375, 0.036, 0.0, d6 - 0.0183 * g, _GREY),),
    ]


UR_ROBOTS: dict[str, Robot] = {name: _robot(name, numbers) for name, numbers in _TABLE.items()}
"""The arms by name."""
