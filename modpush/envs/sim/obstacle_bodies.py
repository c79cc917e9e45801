"""Obstacles of a running scene: replaced on a CPU, taken from a pool on CUDA."""

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import sapien
import torch
from mani_skill.utils.structs import Actor, Pose
from sapien import physx
from torch import Tensor

from modpush.envs.scenes.layouts import BAR_SECTION, CUBE_SIDE
from modpush.envs.scenes.obstacle import Obstacle
from modpush.envs.sim import bodies
from modpush.geometry.shapes import Primitive, box

if TYPE_CHECKING:
    from mani_skill.envs.scene import ManiSkillScene

__all__ = ["DYNAMIC_MASS", "ObstaclePool", "ObstacleSwapper", "obstacle_part"]

DYNAMIC_MASS = 0.5
"""Mass of a movable obstacle [kg]."""
_COLOR = (0.30, 0.33, 0.38)


def obstacle_part(obstacle: Obstacle) -> Primitive:
    """The solid of an obstacle, in its own frame."""
    return box(*obstacle.size, color=_COLOR)


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
        self.actors: list[Actor] = []  # ManiSkill's structs are for bodies that stay
        self._rigid: list[physx.PhysxRigidBaseComponent] = []

    def place(
        self, indices: Sequence[int], layouts: Sequence[Sequence[Obstacle]]
    ) -> list[tuple[Obstacle, ...]]:
        """Add the obstacles of a layout to a new scene; returns the layout that was placed."""
        self._placed = [(o, self._build(o, i)) for i, o in enumerate(layouts[0])]
        for _, entity in self._placed:
            self._scene.sub_scenes[0].add_entity(entity)
        kind = (
            physx.PhysxRigidDynamicComponent if self._dynamic else physx.PhysxRigidStaticComponent
        )
        self._rigid = [entity.find_component_by_type(kind) for _, entity in self._placed]
        return [tuple(layouts[0])]

    def _build(self, obstacle: Obstacle, index: int) -> sapien.Entity:
        """An obstacle at its pose, not yet added to the scene."""
        part = obstacle_part(obstacle)
        mass = DYNAMIC_MASS if self._dynamic else None
        entity = bodies.rigid_body([part], self._material, mass=mass)
        if self._can_render:
            bodies.attach_visuals(entity, [part])
        x, y, yaw = obstacle.pose
        entity.name = f"scene-0_obstacle_{index}"
        entity.pose = bodies.yaw_pose(x, y, obstacle.size[2] / 2, yaw)
        return entity

    def rigid_bodies(self, index: int = 0) -> list[physx.PhysxRigidBaseComponent]:
        """The bodies of the present obstacles."""
        return self._rigid

    def entities(self, index: int = 0) -> list[sapien.Entity]:
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

    def transforms(self, index: int = 0) -> np.ndarray:
        """Position [m] and quaternion (w, x, y, z) of the present obstacles, `[n, 7]`."""
        poses = [entity.pose for _, entity in self._placed]
        return np.array([[*pose.p, *pose.q] for pose in poses]).reshape(-1, 7)


class ObstaclePool:
    """Obstacles of scenes that bodies cannot be added to while they run, as in a GPU simulation.

    The pool has cubes, bars of 7 and 10 cm, and bars in steps of 5 cm. A layout's lengths are rounded
    to these, and `place` returns the layout that was placed. Unused obstacles are parked far away.
    """

    _SIZES = (
        *((CUBE_SIDE,) * 3 for _ in range(24)),
        *((length, BAR_SECTION, BAR_SECTION) for length in (0.07, 0.10) for _ in range(13)),  # hard
        *((0.05 * n, BAR_SECTION, BAR_SECTION) for n in range(3, 13) for _ in range(2)),
    )

    def __init__(
        self, scene: "ManiSkillScene", material: physx.PhysxMaterial, dynamic: bool
    ) -> None:
        self._num_envs = len(scene.sub_scenes)
        self._device = scene.device
        self._in_play: list[list[int]] = [[] for _ in range(self._num_envs)]
        self._poses = torch.tensor(
            [self._parked(slot) for slot in range(len(self._SIZES))],
            dtype=torch.float32,
            device=self._device,
        ).repeat(self._num_envs, 1, 1)  # [B, slots, 7]
        self.actors = [
            self._build(scene, material, dynamic, slot) for slot in range(len(self._SIZES))
        ]

    def _parked(self, slot: int) -> list[float]:
        return [30.0 + 1.0 * (slot % 8), 1.0 * (slot // 8), self._SIZES[slot][2] / 2, 1, 0, 0, 0]

    def _build(
        self,
        scene: "ManiSkillScene",
        material: physx.PhysxMaterial,
        dynamic: bool,
        slot: int,
    ) -> Actor:
        return bodies.build_actor(
            scene,
            f"obstacle_{slot}",
            [box(*self._SIZES[slot], color=_COLOR)],
            material,
            mass=DYNAMIC_MASS,
            pose=sapien.Pose(self._parked(slot)[:3]),
            kinematic=not dynamic,
        )

    def place(
        self, indices: Sequence[int], layouts: Sequence[Sequence[Obstacle]]
    ) -> list[tuple[Obstacle, ...]]:
        """Place layouts in the scenes of these indices; returns the layouts that were placed."""
        standing = []
        for i, layout in zip(indices, layouts, strict=True):
            self._in_play[i] = []
            for slot in range(len(self._SIZES)):
                self._poses[i, slot] = self._poses.new_tensor(self._parked(slot))
            placed = []
            for obstacle in layout:
                slot = self._nearest_slot(i, obstacle)
                self._in_play[i].append(slot)
                x, y, yaw = obstacle.pose
                size = self._SIZES[slot]
                self._poses[i, slot] = self._poses.new_tensor(
                    [x, y, size[2] / 2, math.cos(yaw / 2), 0, 0, math.sin(yaw / 2)]
                )
                placed.append(Obstacle(size, obstacle.pose))
            standing.append(tuple(placed))
        rows = torch.as_tensor(indices, device=self._device)
        for slot, actor in enumerate(self.actors):
            actor.set_pose(Pose.create(self._poses[rows, slot]))
        return standing

    def _nearest_slot(self, index: int, obstacle: Obstacle) -> int:
        """The free slot whose size is nearest."""
        taken = set(self._in_play[index])
        free = [slot for slot in range(len(self._SIZES)) if slot not in taken]
        error = {
            slot: sum(abs(a - b) for a, b in zip(self._SIZES[slot], obstacle.size, strict=True))
            for slot in free
        }
        best = min(error, key=error.__getitem__, default=None)
        if best is None or error[best] > 0.0251:
            raise ValueError(
                f"ObstaclePool: no body of about size {obstacle.size} m is left for scene {index}; "
                f"{len(taken)} are in play."
            )
        return best

    def rigid_bodies(self, index: int = 0) -> list[physx.PhysxRigidBaseComponent]:
        """The bodies of the present obstacles of one scene."""
        return [self.actors[slot]._bodies[index] for slot in self._in_play[index]]

    def entities(self, index: int = 0) -> list[sapien.Entity]:
        """The entities of the present obstacles of one scene."""
        return [self.actors[slot]._objs[index] for slot in self._in_play[index]]

    def transforms(self, index: int = 0) -> np.ndarray:
        """Position [m] and quaternion (w, x, y, z) of one scene's obstacles, `[n, 7]`."""
        rows = [self.actors[slot].pose.raw_pose[index].tolist() for slot in self._in_play[index]]
        return np.array(rows).reshape(-1, 7)
