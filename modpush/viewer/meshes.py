"""Triangle meshes of the primitives that physics uses, and transforms of the arm's links."""

import math

import numpy as np
import trimesh
from numpy.typing import NDArray

from modpush.envs.robot.kinematics import DH_A, DH_ALPHA, DH_D
from modpush.geometry.footprint import outline_of
from modpush.geometry.shapes import Primitive, rpy_matrix

__all__ = ["link_transforms", "primitive_mesh"]

_NUM_ARC = 32  # corners of a circle
_NUM_CAP = 6  # rings of half a sphere


def primitive_mesh(part: Primitive) -> trimesh.Trimesh:
    """The surface of a primitive, all of which are convex, in the frame of its body."""
    upright = Primitive(kind=part.kind, size=part.size, outline=part.outline)
    outline = outline_of(upright, _NUM_ARC)
    half = part.size[2] if part.kind in ("box", "prism") else part.size[1]
    rings = [(-half, 1.0), (half, 1.0)]  # height, and scale of the outline
    if part.kind == "capsule":
        for angle in np.linspace(0.0, math.pi / 2, _NUM_CAP, endpoint=False):
            height = half + part.size[0] * math.sin(angle)
            rings += [(-height, math.cos(angle)), (height, math.cos(angle))]
    points = np.concatenate(
        [np.column_stack([scale * outline, np.full(len(outline), z)]) for z, scale in rings]
    )
    return trimesh.convex.convex_hull(points @ part.rotation().T + np.array(part.position))


def link_transforms(joint_position: NDArray[np.float64]) -> NDArray[np.float64]:
    """Transforms of the arm's links and its tool.

    Args:
        joint_position: Angles of the six joints, `[6]` [rad].

    Returns:
        `[8, 4, 4]`, link to base, in the order of `LINKS`, then the tool's.
    """
    transform = np.eye(4)
    found = [transform]
    for i, angle in enumerate([*joint_position, 0.0]):  # the flange does not turn by itself
        previous = np.eye(4)
        if i > 0:
            previous[:3, :3] = rpy_matrix((DH_ALPHA[i - 1], 0.0, 0.0))
            previous[:3, 3] = DH_A[i - 1], 0.0, DH_D[i - 1]
        turn = np.eye(4)
        turn[:2, :2] = [
            [math.cos(angle), -math.sin(angle)],
            [math.sin(angle), math.cos(angle)],
        ]
        transform = transform @ previous @ turn
        found.append(transform)
    return np.stack(found)
