"""Obstacles of a running scene on a CPU."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import sapien
import torch
from sapien import physx
from torch import Tensor

from modpush.envs.engines.sapien import bodies
from modpush.envs.scenes.obstacle import OBSTACLE_COLOR, OBSTACLE_MASS, Obstacle
from modpush.geometry.shapes import Primitive, box

if TYPE_CHECKING:
    from mani_skill.envs.scene import ManiSkillScene


def obstacle_part(obstacle: Obstacle) -> Primitive:
    """The solid of an obstacle, in its own frame."""
    return box(*obstacle.size, color=OBSTACLE_COLOR)


class ObstacleSwapper:
    """The obstacles of a CPU scene, which are built anew for every episode.

    Every layout gets new bodies, in its own order: PhysX's packed state lists bodies by age.
    """

    def __init__(
        self, scene: "ManiSkillScene", material: physx.PhysxMaterial, dynamic: bool
    ) -> None:
        self._scene = scene
        self._can_render = scene.can_render()
        self._material = material
        self._dynamic = dynamic
        self._placed: list[tuple[Obstacle, sapien.Entity]] = []
        self._rigid: list[physx.PhysxRigidBaseComponent] = []
        self._moving: list[tuple[physx.PhysxRigidDynamicComponent, Obstacle]] = []

    def place(self, layout: Sequence[Obstacle]) -> None:
        """Add the obstacles of a layout to a new scene."""
        self._placed = [(o, self._build(o, i)) for i, o in enumerate(layout)]
        for _, entity in self._placed:
            self._scene.sub_scenes[0].add_entity(entity)
        fixed, free = physx.PhysxRigidStaticComponent, physx.PhysxRigidDynamicComponent
        self._rigid = [
            entity.find_component_by_type(fixed if self._is_fixed(obstacle) else free)
            for obstacle, entity in self._placed
        ]
        moving = zip(layout, self._rigid, strict=True)
        self._moving = [(body, o) for o, body in moving if o.motion is not None]

    def _is_fixed(self, obstacle: Obstacle) -> bool:
        return not self._dynamic and obstacle.motion is None

    def move(self, targets: Sequence[Sequence[float]]) -> None:
        """Let the obstacles that move by themselves go to places within the next physics step.

        Args:
            targets: (x, y, ...) of each of them [m].
        """
        for (body, obstacle), (x, y, *_) in zip(self._moving, targets, strict=True):
            pose = bodies.yaw_pose(x, y, obstacle.size[2] / 2, obstacle.pose[2])
            body.kinematic_target = pose

    def _build(self, obstacle: Obstacle, index: int) -> sapien.Entity:
        """An obstacle at its pose, not yet added to the scene."""
        part = obstacle_part(obstacle)
        mass = None if self._is_fixed(obstacle) else OBSTACLE_MASS
        entity = bodies.rigid_body([part], self._material, mass=mass)
        if obstacle.motion is not None:
            entity.find_component_by_type(physx.PhysxRigidDynamicComponent).kinematic = True
        if self._can_render:
            bodies.attach_visuals(entity, [part])
        x, y, yaw = obstacle.pose
        entity.name = f"scene-0_obstacle_{index}"
        entity.pose = bodies.yaw_pose(x, y, obstacle.size[2] / 2, yaw)
        return entity

    def kinematic_rows(self) -> list[int]:
        """Places, among the present bodies that are not fixed, of those that move by themselves."""
        free = [obstacle for obstacle, _ in self._placed if not self._is_fixed(obstacle)]
        return [row for row, obstacle in enumerate(free) if obstacle.motion is not None]

    def rigid_bodies(self) -> list[physx.PhysxRigidBaseComponent]:
        """The bodies of the present obstacles."""
        return self._rigid

    def entities(self) -> list[sapien.Entity]:
        """The entities of the present obstacles."""
        return [entity for _, entity in self._placed]

    def get_states(self) -> dict[str, Tensor]:
        """Pose and velocities of the movable obstacles by name, as ManiSkill's `Actor.get_state`.

        Each `[1, 13]`: position [m], quaternion (w, x, y, z), linear [m/s] and angular velocity [rad/s].
        """
        states = {}
        for (_, entity), body in zip(self._placed, self._rigid, strict=True):
            if isinstance(body, physx.PhysxRigidDynamicComponent):
                pose = entity.pose
                row = [*pose.p, *pose.q, *body.linear_velocity, *body.angular_velocity]
                states[entity.name] = torch.tensor([row])
        return states

    def set_states(self, states: Mapping[str, Tensor]) -> None:
        """Put the movable obstacles into states of `get_states`."""
        for (_, entity), body in zip(self._placed, self._rigid, strict=True):
            if isinstance(body, physx.PhysxRigidDynamicComponent):
                row = states[entity.name].reshape(13).cpu().numpy()
                entity.pose = sapien.Pose(row[:3], row[3:7])
                body.linear_velocity, body.angular_velocity = row[7:10], row[10:]

    def transforms(self) -> np.ndarray:
        """Position [m] and quaternion (w, x, y, z) of the present obstacles, `[n, 7]`."""
        poses = [entity.pose for _, entity in self._placed]
        return np.array([[*pose.p, *pose.q] for pose in poses]).reshape(-1, 7)
