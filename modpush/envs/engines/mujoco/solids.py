"""MuJoCo's geoms of the library's solids, and which of them collide."""

from collections.abc import Iterable

import mujoco
import numpy as np

from modpush.envs.robot.physics import CONTACT_GAP
from modpush.geometry.shapes import Primitive

ROBOT, OBJECT, OBSTACLE, TABLE = 1, 2, 4, 8
"""Categories of bodies, by which contacts are told apart: the `contype` of their geoms."""

_SOLREF = (0.005, 1.0)
_SOLIMP = (0.95, 0.99, 0.001, 0.5, 2.0)
"""Stiffness of contacts. With MuJoCo's default bodies sink in by up to 4 mm instead of 1.5."""

_KINDS = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "prism": mujoco.mjtGeom.mjGEOM_MESH,
}


def add_solids(
    spec: "mujoco.MjSpec", body: "mujoco.MjsBody", parts: Iterable[Primitive]
) -> "list[mujoco.MjsGeom]":
    """Add the solids of a body as geoms, a prism as the mesh of its corners.

    Args:
        spec: The model that the body is in.
        body: The body.
        parts: Its solids, in its frame.

    Returns:
        The geoms, which collide with nothing yet, see `set_contact`.
    """
    geoms = []
    for i, part in enumerate(parts):
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, part.rotation().ravel())
        geom = body.add_geom(
            type=_KINDS[part.kind], size=part.size, pos=part.position, quat=quaternion
        )
        geom.contype = geom.conaffinity = 0
        geom.rgba = (*part.color, 1.0)
        if part.kind == "prism":
            geom.meshname = f"{body.name}_{i}"
            spec.add_mesh(name=geom.meshname, uservert=_corners(part))
        geoms.append(geom)
    return geoms


def _corners(part: Primitive) -> np.ndarray:
    """Corners of a prism, `[2 n * 3]` [m]."""
    outline, half = np.array(part.outline), part.size[2]
    return np.concatenate([np.insert(outline, 2, z, axis=1) for z in (-half, half)]).ravel()


def set_contact(
    geoms: "Iterable[mujoco.MjsGeom]",
    category: int,
    against: int,
    friction: float,
    priority: int = 0,
) -> None:
    """Say what geoms collide with, and how.

    MuJoCo takes the friction of the geom with the higher priority, or the larger of two.

    Args:
        geoms: The geoms of a body.
        category: Their category.
        against: Sum of the categories that they collide with.
        friction: Friction coefficient of the pairs in which their priority is the higher one.
        priority: Their priority.
    """
    for geom in geoms:
        geom.contype, geom.conaffinity = category, against
        geom.friction[0], geom.priority = friction, priority
        geom.solref, geom.solimp = _SOLREF, _SOLIMP
        # The gaps of two geoms add up. A margin would do more: forces begin there, so that bodies float.
        geom.gap = CONTACT_GAP / 2
