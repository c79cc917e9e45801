"""The URDF of an arm with a tool, and the masses that engines need.

Collision shapes only, and primitives only: SAPIEN refuses every `<visual>` where there is no
renderer, and primitives step 2.4-2.8 times faster than the published meshes. The rendered robot is
drawn from the same shapes, so that both cameras and the physics see one and the same arm.
"""

from collections.abc import Sequence
from functools import lru_cache
from xml.etree import ElementTree as ET

import numpy as np

from modpush.envs.robot.robot import Robot, Tool
from modpush.geometry.shapes import Primitive

_ORIGIN = (0.0, 0.0, 0.0)


@lru_cache(maxsize=64)  # every scene of a batch asks for the same
def urdf_text(robot: Robot, tool: Tool) -> str:
    """The URDF; beside the robot's links there are `tool` and `tip`."""
    root = ET.Element("robot", name=f"{robot.name}_{tool.name}")
    for link in robot.links:
        _add_link(root, link.name, link.mass, link.shapes)
    # ManiSkill asks for the flange and the tip by name; the tool hangs rigidly on the last link.
    _add_link(root, "tool", tool.mass, tool.shapes)
    _add_link(root, "tip", 0.0, ())
    for i, joint in enumerate(robot.joints):
        links = robot.links[i].name, robot.links[i + 1].name
        added = _add_joint(root, joint.name, *links, joint.position, joint.rpy)
        added.set("type", "revolute")
        ET.SubElement(added, "axis", xyz=_numbers(joint.axis))
        low, high = joint.limits
        limits = {"lower": f"{low:.9g}", "upper": f"{high:.9g}", "effort": f"{joint.effort:g}"}
        ET.SubElement(added, "limit", {**limits, "velocity": "3.15"})
    last = robot.links[-1].name
    _add_joint(root, "flange", last, "tool", robot.flange_position, robot.flange_rpy)
    _add_joint(root, "tool_tip", "tool", "tip", (0.0, 0.0, tool.length), _ORIGIN)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def mass_properties(
    mass: float, shapes: tuple[Primitive, ...]
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Centre of mass [m] and diagonal of the inertia about it [kg m^2] of a link or tool.

    The centre is the mean of the shapes' centres, weighted by their boxes' volumes, and the inertia that
    of the solid box around all the shapes. The figures in circulation for a UR5's wrist are 50-180 times
    too large; the arm is position controlled with strong drives, so that an estimate of the right
    size is all that is needed.
    """
    extents = np.array([extent(shape) for shape in shapes])
    positions, volumes = np.array([shape.position for shape in shapes]), extents.prod(1)
    center = (volumes[:, None] * positions).sum(0) / volumes.sum()
    size = (positions + extents / 2).max(0) - (positions - extents / 2).min(0)
    x, y, z = np.square(size)
    inertia = mass * np.array([y + z, x + z, x + y]) / 12
    return tuple(center.tolist()), tuple(inertia.tolist())


def extent(shape: Primitive) -> tuple[float, float, float]:
    """Full size of a solid along its body's axes, to a nanometre [m]."""
    rotation, (a, b, c) = np.abs(shape.rotation()), shape.size
    if shape.kind in ("box", "prism"):
        half = rotation @ (a, b, c)
    else:
        along = rotation[:, 2]
        across = np.ones(3) if shape.kind == "capsule" else np.sqrt(1 - np.minimum(along, 1) ** 2)
        half = along * b + across * a
    x, y, z = np.round(2 * half, 9).tolist()
    return x, y, z


def _add_joint(
    root: ET.Element,
    name: str,
    parent: str,
    child: str,
    xyz: Sequence[float],
    rpy: Sequence[float],
) -> ET.Element:
    joint = ET.SubElement(root, "joint", name=name, type="fixed")
    ET.SubElement(joint, "origin", xyz=_numbers(xyz), rpy=_numbers(rpy))
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
    return joint


def _add_link(root: ET.Element, name: str, mass: float, shapes: tuple[Primitive, ...]) -> None:
    link = ET.SubElement(root, "link", name=name)
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


def _numbers(values: Sequence[float]) -> str:
    return " ".join(f"{value:.9g}" for value in values)
