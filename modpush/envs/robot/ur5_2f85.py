"""The UR5 and its tools as data: shapes, masses and limits, and the URDF made from them.

Collision shapes only, and primitives only: SAPIEN refuses every `<visual>` where there is no
renderer, and primitives step 2.4-2.8 times faster than the published meshes. The rendered robot is
drawn from the same shapes, so that both cameras and the physics see one and the same arm.

Source: Denavit-Hartenberg numbers, masses and limits as published by the maker; sizes of the closed
gripper as measured on the 2F-85.
"""

import math
from pathlib import Path
from typing import Literal
from xml.etree import ElementTree as ET

from modpush._types import Length, LengthSpan, Name, Positive, Several
from modpush._validation import checked
from modpush.envs.robot.kinematics import DH_A, DH_ALPHA, DH_D
from modpush.geometry.shapes import Primitive, box, capsule, cylinder

__all__ = [
    "FORCE_LIMIT",
    "JOINT_LIMIT",
    "JOINT_NAMES",
    "LINKS",
    "TOOLS",
    "Link",
    "Tool",
    "ToolName",
    "joint_origin",
    "mass_properties",
    "urdf_path",
    "urdf_text",
]

_GREY, _DARK, _BLUE = (0.72, 0.74, 0.76), (0.25, 0.26, 0.28), (0.35, 0.58, 0.78)
_SIDEWAYS = (0.0, math.pi / 2, 0.0)  # turns a capsule's z onto the link's x

JOINT_NAMES = (
    "shoulder_pan",
    "shoulder_lift",
    "elbow",
    "wrist_1",
    "wrist_2",
    "wrist_3",
)
JOINT_LIMIT = (2 * math.pi, 2 * math.pi, math.pi, 2 * math.pi, 2 * math.pi, 2 * math.pi)
"""Largest absolute angle of each joint [rad]."""
FORCE_LIMIT = (150.0, 150.0, 150.0, 28.0, 28.0, 28.0)
"""Torque limits of the joint drives [N m]. SAPIEN's URDF loader ignores those in the file."""
_VELOCITY_LIMIT = (3.15, 3.15, 3.15, 3.2, 3.2, 3.2)

ToolName = Literal["2f85", "rod"]


@checked
class Link:
    """A link of the arm; its frame is the joint's, z along the joint's axis."""

    name: Name
    mass: Positive
    """Mass [kg]."""
    shapes: Several[Primitive]


@checked
class Tool:
    """A tool that is mounted on the flange; its frame's z axis points out of the flange."""

    name: ToolName
    mass: Positive
    """Mass [kg]."""
    length: Length
    """Distance from the flange to the tip [m]."""
    tip_half_extents: LengthSpan
    """Half the footprint of the tip along the tool's x and y [m]."""
    shapes: Several[Primitive]


LINKS = (
    Link(
        name="base",
        mass=4.0,
        shapes=(cylinder(0.075, 0.04, (0.0, 0.0, 0.02), color=_DARK),),
    ),
    Link(
        name="shoulder",
        mass=3.7,
        shapes=(cylinder(0.06, 0.178, (0.0, 0.0, 0.089159), color=_GREY),),
    ),
    Link(
        name="upper_arm",
        mass=8.393,
        shapes=(
            cylinder(0.06, 0.13, (0.0, 0.0, 0.125), color=_BLUE),
            capsule(0.052, 0.425, (-0.2125, 0.0, 0.13585), rpy=_SIDEWAYS, color=_GREY),
            cylinder(0.055, 0.13, (-0.425, 0.0, 0.125), color=_BLUE),
        ),
    ),
    Link(
        name="forearm",
        mass=2.275,
        shapes=(
            capsule(0.042, 0.39225, (-0.196125, 0.0, 0.01615), rpy=_SIDEWAYS, color=_GREY),
            cylinder(0.045, 0.10, (-0.39225, 0.0, 0.02), color=_BLUE),
        ),
    ),
    Link(
        name="wrist_1",
        mass=1.219,
        shapes=(cylinder(0.0375, 0.12, (0.0, 0.0, 0.10), color=_GREY),),
    ),
    Link(
        name="wrist_2",
        mass=1.219,
        shapes=(cylinder(0.0375, 0.11, (0.0, 0.0, 0.085), color=_BLUE),),
    ),
    Link(
        name="wrist_3",
        mass=0.1879,
        shapes=(cylinder(0.0375, 0.036, (0.0, 0.0, 0.064), color=_GREY),),
    ),
)

TOOLS: dict[ToolName, Tool] = {
    # Closed by construction: one rigid link. The linkage juts out beyond the fingers along x.
    "2f85": Tool(
        name="2f85",
        mass=0.9,
        length=0.163,
        tip_half_extents=(0.032, 0.011),
        shapes=(
            box(0.084, 0.076, 0.090, (0.0, 0.0, 0.045), color=_DARK),
            box(0.124, 0.027, 0.071, (0.0, 0.0, 0.0825), color=_DARK),
            box(0.064, 0.022, 0.057, (0.0, 0.0, 0.1345), color=_GREY),
        ),
    ),
    "rod": Tool(
        name="rod",
        mass=0.2,
        length=0.16,
        tip_half_extents=(0.01, 0.01),
        shapes=(box(0.02, 0.02, 0.16, (0.0, 0.0, 0.08), color=_DARK),),
    ),
}
"""The tools by name. The paper names the gripper; the authors' released code pushes with the rod."""


def joint_origin(index: int) -> tuple[tuple[float, float, float], float]:
    """Place of a joint's frame in that of the link before it: position [m] and roll [rad]."""
    if index == 0:
        return (0.0, 0.0, 0.0), 0.0
    return (DH_A[index - 1], 0.0, DH_D[index - 1]), DH_ALPHA[index - 1]


def mass_properties(
    mass: float, shapes: tuple[Primitive, ...]
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Centre of mass [m] and diagonal of the inertia about it [kg m^2] of a link or tool."""
    return _center(shapes), _inertia(mass, shapes)


def urdf_path(tool: ToolName) -> Path:
    """Path of the shipped URDF of the arm with this tool."""
    return Path(__file__).parent / "assets" / f"ur5_{tool}.urdf"


def urdf_text(tool: ToolName) -> str:
    """The URDF made from the tables of this module, as shipped in `assets/`."""
    robot = ET.Element("robot", name=f"ur5_{tool}")
    for link in LINKS:
        _add_link(robot, link.name, link.mass, link.shapes)
    # ManiSkill asks for the flange and the tip by name; the tool hangs rigidly on the last link.
    _add_link(robot, "tool", TOOLS[tool].mass, TOOLS[tool].shapes)
    _add_link(robot, "tip", 0.0, ())
    for i, name in enumerate(JOINT_NAMES):
        joint = _add_joint(robot, name, LINKS[i].name, LINKS[i + 1].name, *joint_origin(i))
        joint.set("type", "revolute")
        ET.SubElement(joint, "axis", xyz="0 0 1")
        ET.SubElement(
            joint,
            "limit",
            lower=f"{-JOINT_LIMIT[i]:.9g}",
            upper=f"{JOINT_LIMIT[i]:.9g}",
            effort=f"{FORCE_LIMIT[i]:g}",
            velocity=f"{_VELOCITY_LIMIT[i]:g}",
        )
    _add_joint(robot, "flange", LINKS[-1].name, "tool", (0.0, 0.0, DH_D[5]), 0.0)
    _add_joint(robot, "tool_tip", "tool", "tip", (0.0, 0.0, TOOLS[tool].length), 0.0)
    ET.indent(robot)
    return ET.tostring(robot, encoding="unicode") + "\n"


def _add_joint(
    robot: ET.Element,
    name: str,
    parent: str,
    child: str,
    xyz: tuple[float, float, float],
    roll: float,
) -> ET.Element:
    joint = ET.SubElement(robot, "joint", name=name, type="fixed")
    ET.SubElement(joint, "origin", xyz=_numbers(xyz), rpy=_numbers((roll, 0.0, 0.0)))
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
    return joint


def _add_link(robot: ET.Element, name: str, mass: float, shapes: tuple[Primitive, ...]) -> None:
    link = ET.SubElement(robot, "link", name=name)
    if mass > 0:
        inertial = ET.SubElement(link, "inertial")
        center, diagonal = mass_properties(mass, shapes)
        ET.SubElement(inertial, "origin", xyz=_numbers(center), rpy="0 0 0")
        ET.SubElement(inertial, "mass", value=f"{mass:g}")
        values = dict(zip(("ixx", "iyy", "izz"), diagonal, strict=True))
        inertia = {name: f"{value:.9g}" for name, value in values.items()}
        ET.SubElement(inertial, "inertia", inertia | dict.fromkeys(("ixy", "ixz", "iyz"), "0"))
    for shape in shapes:
        collision = ET.SubElement(link, "collision")
        ET.SubElement(collision, "origin", xyz=_numbers(shape.position), rpy=_numbers(shape.rpy))
        geometry = ET.SubElement(collision, "geometry")
        if shape.kind == "box":
            ET.SubElement(geometry, "box", size=_numbers(tuple(2 * x for x in shape.size)))
        else:
            radius, half_length, _ = shape.size
            ET.SubElement(
                geometry, shape.kind, radius=f"{radius:.9g}", length=f"{2 * half_length:.9g}"
            )


def _extent(shape: Primitive) -> tuple[float, float, float]:
    """Full size along the link's axes of a shape that is turned by right angles at most [m]."""
    if shape.kind == "box":
        hx, hy, hz = shape.size
        return 2 * hx, 2 * hy, 2 * hz
    radius, half_length, _ = shape.size
    length = 2 * half_length + (2 * radius if shape.kind == "capsule" else 0.0)
    if shape.rpy == _SIDEWAYS:
        return length, 2 * radius, 2 * radius
    return 2 * radius, 2 * radius, length


def _center(shapes: tuple[Primitive, ...]) -> tuple[float, float, float]:
    """Mean of the shapes' centres, weighted by their boxes' volumes [m]."""
    volumes = [math.prod(_extent(shape)) for shape in shapes]
    x, y, z = (
        sum(v * shape.position[axis] for v, shape in zip(volumes, shapes, strict=True))
        / sum(volumes)
        for axis in range(3)
    )
    return x, y, z


def _inertia(mass: float, shapes: tuple[Primitive, ...]) -> tuple[float, float, float]:
    """Diagonal inertia [kg m^2] of the solid box around all the shapes.

    The figures in circulation for the wrist are 50-180 times too large; the arm is position
    controlled with strong drives, so that an estimate of the right size is all that is needed.
    """
    low = [min(s.position[a] - _extent(s)[a] / 2 for s in shapes) for a in range(3)]
    high = [max(s.position[a] + _extent(s)[a] / 2 for s in shapes) for a in range(3)]
    x, y, z = (h - lo for h, lo in zip(high, low, strict=True))
    return (
        mass * (y * y + z * z) / 12,
        mass * (x * x + z * z) / 12,
        mass * (x * x + y * y) / 12,
    )


def _numbers(values: tuple[float, ...]) -> str:
    return " ".join(f"{value:.9g}" for value in values)


if __name__ == "__main__":  # rewrites the shipped files: python -m modpush.envs.robot.ur5_2f85
    for _name in TOOLS:
        urdf_path(_name).parent.mkdir(exist_ok=True)
        urdf_path(_name).write_text(urdf_text(_name), encoding="utf-8")
