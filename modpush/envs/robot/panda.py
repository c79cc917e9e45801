"""Franka Emika's Panda, an arm of seven joints.

Source: joints, limits, efforts and masses of ManiSkill's description of it (`panda_v2.urdf`); its solids
are cylinders, capsules and boxes around the meshes there.
"""

import math

from modpush.envs.robot.robot import Joint, Link, Robot
from modpush.geometry.shapes import box, capsule, cylinder

_WHITE, _DARK = (0.90, 0.91, 0.92), (0.25, 0.26, 0.28)
_QUARTER = math.pi / 2
_Y_AXIS = (_QUARTER, 0.0, 0.0)  # turns a solid's z onto the link's y

_LINKS = (
    Link(
        name="link_0",
        mass=0.629769,
        shapes=(
            box(0.19, 0.15, 0.10, (-0.06, 0.0, -0.05), color=_DARK),  # a plate under its foot
            box(0.19, 0.15, 0.06, (-0.06, 0.0, 0.03), color=_WHITE),
            cylinder(0.075, 0.14, (0.0, 0.0, 0.07), color=_WHITE),
        ),
    ),
    Link(
        name="link_1",
        mass=4.970684,
        shapes=(
            cylinder(0.06, 0.18, (0.0, 0.0, -0.10), color=_WHITE),
            cylinder(0.06, 0.14, (0.0, -0.01, 0.0), rpy=_Y_AXIS, color=_DARK),
        ),
    ),
    Link(
        name="link_2",
        mass=0.646926,
        shapes=(
            cylinder(0.06, 0.12, (0.0, 0.0, 0.01), color=_WHITE),
            cylinder(0.06, 0.16, (0.0, -0.12, 0.0), rpy=_Y_AXIS, color=_WHITE),
        ),
    ),
    Link(
        name="link_3",
        mass=3.228604,
        shapes=(
            cylinder(0.06, 0.12, (0.0, 0.0, -0.07), color=_WHITE),
            cylinder(0.055, 0.12, (0.0825, 0.0, 0.0), rpy=_Y_AXIS, color=_DARK),
        ),
    ),
    Link(
        name="link_4",
        mass=3.587895,
        shapes=(
            cylinder(0.055, 0.12, (0.0, 0.0, 0.0), color=_DARK),
            cylinder(0.055, 0.10, (-0.0825, 0.08, 0.0), rpy=_Y_AXIS, color=_WHITE),
        ),
    ),
    Link(
        name="link_5",
        mass=1.225946,
        shapes=(
            cylinder(0.055, 0.12, (0.0, 0.0, -0.26), color=_WHITE),
            capsule(0.04, 0.18, (0.0, 0.06, -0.13), color=_WHITE),
            cylinder(0.05, 0.14, (0.0, 0.02, 0.0), rpy=_Y_AXIS, color=_DARK),
        ),
    ),
    Link(
        name="link_6",
        mass=1.666555,
        shapes=(
            cylinder(0.05, 0.10, (0.0, 0.0, 0.0), color=_DARK),
            cylinder(0.05, 0.13, (0.088, 0.01, 0.0), rpy=_Y_AXIS, color=_WHITE),
        ),
    ),
    Link(
        name="link_7",
        mass=0.735522,
        shapes=(cylinder(0.045, 0.05, (0.0, 0.0, 0.08), color=_DARK),),
    ),
)

_PLACES = (
    ((0.0, 0.0, 0.333), (0.0, 0.0, 0.0)),
    ((0.0, 0.0, 0.0), (-_QUARTER, 0.0, 0.0)),
    ((0.0, -0.316, 0.0), (_QUARTER, 0.0, 0.0)),
    ((0.0825, 0.0, 0.0), (_QUARTER, 0.0, 0.0)),
    ((-0.0825, 0.384, 0.0), (-_QUARTER, 0.0, 0.0)),
    ((0.0, 0.0, 0.0), (_QUARTER, 0.0, 0.0)),
    ((0.088, 0.0, 0.0), (_QUARTER, 0.0, 0.0)),
)
_LIMITS = (
    (-2.8973, 2.8973),
    (-1.7628, 1.7628),
    (-2.8973, 2.8973),
    (-3.0718, -0.0698),
    (-2.8973, 2.8973),
    (-0.0175, 3.7525),
    (-2.8973, 2.8973),
)
_EFFORTS = (87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0)

PANDA = Robot(
    name="panda",
    links=_LINKS,
    joints=tuple(
        Joint(name=f"joint_{i}", position=position, rpy=rpy, limits=limits, effort=effort)
        for i, ((position, rpy), limits, effort) in enumerate(
            zip(_PLACES, _LIMITS, _EFFORTS, strict=True), start=1
        )
    ),
    home=(-1.08, 0.83, 0.83, -2.43, -1.45, 2.56, 0.0),
    reach=(0.10, 0.785),
    flange_position=(0.0, 0.0, 0.107),
    base=(0.07, 0.0, 0.10),
)
"""The arm, on a plate of 10 cm, with its elbow swung aside at home. So the tool works from 10 cm on: with
the elbow in the plane of the arm the fourth joint is at its limit already at 25 cm, and the way around it
leads through a singularity. `DampedLeastSquares` keep the elbow there."""
