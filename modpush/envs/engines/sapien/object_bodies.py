"""The bodies of the objects that may be pushed, one of each kind in every scene, and their feet.

An object with a shifted centre of mass stands on feet.
"""

from collections.abc import Iterable, Sequence

import numpy as np
import sapien
import torch
from mani_skill.envs.scene import ManiSkillScene
from mani_skill.utils.structs import Pose
from sapien import physx
from torch import Tensor

from modpush.envs.engines.sapien import bodies
from modpush.envs.scenes.objects import PushedObject, get_object_of
from modpush.envs.scenes.scenario import Scenario
from modpush.geometry.footprint import outline_of, vertical_range
from modpush.geometry.shapes import Primitive

_PARKED = (20.0, 0.0)  # objects that are not in play stand in a row from here on [m]
_GROUP = 1 << 5
"""Collision group of feet and table alone: two shapes collide whose first two words share a bit."""
_RADIUS = 0.004  # of a foot [m]
_AHEAD = 5e-5  # by which feet reach lower than the object, so that it stands on them alone [m]
_ARC = 8  # feet around a cylinder


class ObjectBodies:
    """Builds the objects with the mass and inertia of homogeneous solids, parked far away.

    Their material is common to all; a CPU scene sets its friction at every reset.
    """

    def __init__(
        self, scene: ManiSkillScene, items: Sequence[PushedObject], material: physx.PhysxMaterial
    ) -> None:
        self.items = items
        self.material = material
        self._poses = {item.name: _parking_pose(item, i) for i, item in enumerate(items)}
        self.actors = {
            item.name: bodies.build_actor(
                scene, item.name, item.parts, material, mass=item.mass, pose=self._poses[item.name]
            )
            for item in items
        }
        """ManiSkill's actors, by the object's name."""

    def item(self, name: str) -> PushedObject:
        """The object of this name.

        Raises:
            ValueError: If it was not built; the message lists those that were.
        """
        return get_object_of(self.items, name)

    def place(self, scenarios: Sequence[Scenario]) -> None:
        """Put the pushed objects of the scenes being reset at their starts, and all others far away.

        Mass, centre of mass and friction stay as they were built: a running GPU simulation does not take
        others.
        """
        for name, actor in self.actors.items():
            item = self.item(name)
            poses = [
                bodies.yaw_pose(*s.object_pose[:2], item.height / 2, s.object_pose[2])
                if s.pushed_object == name
                else self._poses[name]
                for s in scenarios
            ]
            rows = np.array([[*pose.p, *pose.q] for pose in poses], dtype=np.float32)
            actor.set_pose(Pose.create(torch.from_numpy(rows).to(actor.device)))

    def transforms(self, names: Sequence[str]) -> Tensor:
        """Position and quaternion (w, x, y, z) of the named object of every scene, `[B, 7]`."""
        poses = {name: actor.pose.raw_pose for name, actor in self.actors.items()}
        return torch.stack([poses[name][i] for i, name in enumerate(names)])


def _parking_pose(item: PushedObject, index: int) -> sapien.Pose:
    return bodies.yaw_pose(_PARKED[0], _PARKED[1] + index, item.height / 2, 0.0)


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
