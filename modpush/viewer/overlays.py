"""Meshes, lines and pictures that the page shows."""

import math
from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray

from modpush.geometry.footprint import outline_of
from modpush.geometry.shapes import Primitive

_RIM = (235, 120, 40)  # color of the inflated map


@dataclass
class Overlays:
    """Overlays that are shown."""

    path: bool = True  # The planned path
    subgoal: bool = True  # The present sub-goal
    map: bool = False  # The inflated map, where the object's centre cannot be
    flags: bool = True  # Contact, collision, success and out of bounds


def path_segments(path: NDArray[np.float64] | None, height: float) -> NDArray[np.float32]:
    """A path `[n, 2]` as line segments `[n - 1, 2, 3]` at a height [m]; one without length for None."""
    if path is None or len(path) < 2:
        return np.zeros((1, 2, 3), dtype=np.float32)
    points = np.column_stack([path, np.full(len(path), height)])
    return np.stack([points[:-1], points[1:]], axis=1).astype(np.float32)


def map_picture(occupancy: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """The inflated map as a half transparent picture, `[H, W, 4]`."""
    picture = np.zeros((*occupancy.shape, 4), dtype=np.uint8)
    picture[occupancy] = (*_RIM, 110)
    return picture


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
