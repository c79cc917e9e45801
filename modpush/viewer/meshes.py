"""Triangle meshes of the primitives that physics uses."""

import math

import numpy as np
import trimesh

from modpush.geometry.footprint import outline_of
from modpush.geometry.shapes import Primitive

__all__ = ["primitive_mesh"]

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
