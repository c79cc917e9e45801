"""Triangle meshes of the primitives that physics uses, and transforms of the arm's links."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from modpush.envs.robot.kinematics import DH_A, DH_ALPHA, DH_D
from modpush.geometry.footprint import outline_of
from modpush.geometry.shapes import Primitive, rpy_matrix

__all__ = ["Mesh", "link_transforms", "primitive_mesh"]

_NUM_ARC = 32  # corners of a circle
_NUM_CAP = 6  # rings of half a sphere


class Mesh(NamedTuple):
    """A closed surface of triangles."""

    vertices: NDArray[np.float64]
    """`[n, 3]` [m]."""
    faces: NDArray[np.int64]
    """`[m, 3]`, counter-clockwise seen from outside."""


def primitive_mesh(part: Primitive) -> Mesh:
    """The surface of a primitive, in the frame of the body that it belongs to."""
    upright = Primitive(kind=part.kind, size=part.size, outline=part.outline)
    outline = outline_of(upright, _NUM_ARC)
    half = part.size[2] if part.kind in ("box", "prism") else part.size[1]
    heights, scales = [-half, half], [1.0, 1.0]
    if part.kind == "capsule":
        angle = np.linspace(0.0, math.pi / 2, _NUM_CAP, endpoint=False)
        top = half + part.size[0] * np.sin(angle)
        heights = [*(-top[::-1]).tolist(), *top.tolist()]
        scales = [*np.cos(angle)[::-1].tolist(), *np.cos(angle).tolist()]
    mesh = _stack_outlines(outline, heights, scales)
    return Mesh(mesh.vertices @ part.rotation().T + np.array(part.position), mesh.faces)


def _stack_outlines(
    outline: NDArray[np.float64], heights: list[float], scales: list[float]
) -> Mesh:
    """The solid between copies of a convex outline `[n, 2]`, one at each height."""
    n, rings = len(outline), len(heights)
    vertices = np.concatenate(
        [
            np.column_stack([outline * scale, np.full(n, height)])
            for height, scale in zip(heights, scales, strict=True)
        ]
    )
    i = np.arange(n)
    after = np.roll(i, -1)
    faces = []
    for ring in range(rings - 1):
        low, high = ring * n, (ring + 1) * n
        faces += [
            np.column_stack([low + i, low + after, high + after]),
            np.column_stack([low + i, high + after, high + i]),
        ]
    fan, top = np.arange(1, n - 1), (rings - 1) * n
    faces.append(np.column_stack([np.zeros_like(fan), fan + 1, fan]))
    faces.append(top + np.column_stack([np.zeros_like(fan), fan, fan + 1]))
    return Mesh(vertices, np.concatenate(faces))


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
