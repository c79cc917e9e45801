"""The points on which an object with a shifted centre of mass stands on the table."""

from collections.abc import Iterable, Sequence

import numpy as np
import sapien
from sapien import physx

from modpush.geometry.footprint import outline_of, vertical_range
from modpush.geometry.shapes import Primitive

_GROUP = (
    1 << 5
)  # of feet and table alone: two shapes collide whose first two words have a bit in common
_RADIUS = 0.004  # of a foot [m]
_AHEAD = 5e-5  # by which feet reach lower than the object, so that it stands on them alone [m]
_ARC = 8  # feet around a cylinder


def add_to_group(table: physx.PhysxCollisionShape) -> None:
    """Let feet stand on a shape."""
    first, second, *others = table.collision_groups
    table.set_collision_groups([first | _GROUP, second | _GROUP, *others])


def attach_feet(
    body: physx.PhysxRigidDynamicComponent,
    parts: Iterable[Primitive],
    material: physx.PhysxMaterial,
) -> list[physx.PhysxCollisionShape]:
    """Attach a small sphere to each lowest corner of a body; mass and inertia have to be set afterwards.

    PhysX spreads the friction of a shape on the table evenly over the area of contact, so that the centre
    of mass would have no influence on how a pushed object turns. Each foot is a contact of its own, and
    bears the load that falls on it.
    """
    feet = []
    for x, y, z in _lowest_corners(tuple(parts)):
        foot = physx.PhysxCollisionShapeSphere(_RADIUS, material)
        foot.local_pose = sapien.Pose([x, y, z + _RADIUS - _AHEAD])
        body.attach(foot)
        feet.append(foot)
    return feet


def stand_on_feet(feet: Sequence[physx.PhysxCollisionShape], standing: bool) -> None:
    """Let a body stand on its feet, or as if it had none."""
    group = _GROUP if standing else 0
    for foot in feet:
        foot.set_collision_groups([group, group, 0, 0])


def _lowest_corners(parts: Sequence[Primitive]) -> np.ndarray:
    """Corners of the parts that reach lowest, `[n, 3]`, in the object's frame [m]."""
    low = min(vertical_range(part)[0] for part in parts)
    standing = [part for part in parts if vertical_range(part)[0] - low < _AHEAD]
    outlines = [outline_of(part, _ARC) for part in standing]
    corners = np.unique(np.concatenate(outlines).round(6), axis=0)
    return np.column_stack([corners, np.full(len(corners), low)])
