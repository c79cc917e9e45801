"""SAPIEN bodies made of primitives: collision shapes, and visuals where there is a renderer."""

import functools
import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np
import sapien
import torch
from mani_skill.utils.structs import Actor, Pose
from sapien import physx
from transforms3d.quaternions import mat2quat

from modpush.geometry.shapes import Kind, Primitive, rpy_matrix

if TYPE_CHECKING:
    from mani_skill.envs.scene import ManiSkillScene

# SAPIEN's cylinders and capsules lie along x, ours stand along z.
_X_TO_Z = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])


def yaw_pose(x: float, y: float, z: float, yaw: float) -> sapien.Pose:
    """An upright pose [m, rad]."""
    return sapien.Pose([x, y, z], [math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)])


def _local_pose(part: Primitive) -> sapien.Pose:
    return sapien.Pose(part.position, _local_quaternion(part.kind, part.rpy))


@functools.cache  # obstacles are built at every reset, all of one orientation
def _local_quaternion(kind: Kind, rpy: tuple[float, float, float]) -> np.ndarray:
    rotation = rpy_matrix(rpy)
    if kind in ("cylinder", "capsule"):
        rotation = rotation @ _X_TO_Z
    return mat2quat(rotation)


def _prism_vertices(part: Primitive) -> np.ndarray:
    """Bottom ring, then top ring, `[2 n, 3]` float32 [m]."""
    outline = np.array(part.outline, dtype=np.float32)
    half = np.full((len(outline), 1), part.size[2], dtype=np.float32)
    return np.vstack([np.hstack([outline, -half]), np.hstack([outline, half])])


def collision_shapes(
    parts: Iterable[Primitive], material: physx.PhysxMaterial
) -> list[physx.PhysxCollisionShape]:
    """PhysX shapes of a body's parts, all of one material."""
    shapes = []
    for part in parts:
        if part.kind == "box":
            shape = physx.PhysxCollisionShapeBox(half_size=part.size, material=material)
        elif part.kind == "cylinder":
            shape = physx.PhysxCollisionShapeCylinder(*part.size[:2], material=material)
        elif part.kind == "capsule":
            shape = physx.PhysxCollisionShapeCapsule(*part.size[:2], material=material)
        else:
            shape = physx.PhysxCollisionShapeConvexMesh(
                vertices=_prism_vertices(part),
                scale=np.ones(3, dtype=np.float32),
                material=material,
            )
        shape.local_pose = _local_pose(part)
        shapes.append(shape)
    return shapes


def attach_visuals(entity: sapien.Entity, parts: Iterable[Primitive]) -> None:
    """Draw a body's parts. Call it only where there is a renderer: SAPIEN raises otherwise."""
    component = sapien.render.RenderBodyComponent()
    for part in parts:
        material = sapien.render.RenderMaterial(
            base_color=[*part.color, 1.0], roughness=0.6, specular=0.3
        )
        if part.kind == "box":
            shape = sapien.render.RenderShapeBox(part.size, material)
        elif part.kind == "cylinder":
            shape = sapien.render.RenderShapeCylinder(*part.size[:2], material)
        elif part.kind == "capsule":
            shape = sapien.render.RenderShapeCapsule(*part.size[:2], material)
        else:
            shape = _prism_visual(part, material)
        shape.local_pose = _local_pose(part)
        component.attach(shape)
    entity.add_component(component)


def _prism_visual(
    part: Primitive, material: "sapien.render.RenderMaterial"
) -> "sapien.render.RenderShapeTriangleMesh":
    """A prism with flat faces: every face has its own vertices, so that normals are its own."""
    ring = _prism_vertices(part)
    n = len(part.outline)
    faces = [np.array([ring[n], ring[n + i], ring[n + i + 1]]) for i in range(1, n - 1)]
    faces += [np.array([ring[0], ring[i + 1], ring[i]]) for i in range(1, n - 1)]
    for i in range(n):
        j = (i + 1) % n
        faces += [
            np.array([ring[i], ring[j], ring[n + j]]),
            np.array([ring[i], ring[n + j], ring[n + i]]),
        ]
    vertices = np.concatenate(faces)
    normals = np.concatenate(
        [np.repeat(np.cross(f[1] - f[0], f[2] - f[0])[None], 3, axis=0) for f in faces]
    )
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return sapien.render.RenderShapeTriangleMesh(
        vertices.astype(np.float32),
        np.arange(len(vertices), dtype=np.uint32).reshape(-1, 3),
        normals.astype(np.float32),
        np.zeros((len(vertices), 2), dtype=np.float32),
        material,
    )


def rigid_body(
    parts: Iterable[Primitive], material: physx.PhysxMaterial, *, mass: float | None = None
) -> sapien.Entity:
    """An entity with collision shapes; fixed, or free to move where a mass [kg] is given."""
    parts = tuple(parts)
    body = physx.PhysxRigidStaticComponent() if mass is None else physx.PhysxRigidDynamicComponent()
    for shape in collision_shapes(parts, material):
        body.attach(shape)
    if mass is not None:
        # Shapes came with a density of their own; the inertia goes with the mass.
        body.inertia = body.inertia * (mass / body.mass)
        body.mass = mass
    entity = sapien.Entity()
    entity.add_component(body)
    return entity


def build_actor(
    scene: "ManiSkillScene",
    name: str,
    parts: Sequence[Primitive],
    material: physx.PhysxMaterial,
    *,
    mass: float,
    pose: sapien.Pose,
    kinematic: bool = False,
) -> Actor:
    """ManiSkill's actor of a body in every scene, kept in the state dictionary; mass in kg.

    A kinematic one moves only where its pose is set.
    """
    entities = []
    for i, sub_scene in enumerate(scene.sub_scenes):
        entity = rigid_body(parts, material, mass=mass)
        if kinematic:
            entity.find_component_by_type(physx.PhysxRigidDynamicComponent).kinematic = True
        if scene.can_render():
            attach_visuals(entity, parts)
        entity.name = f"scene-{i}_{name}"
        entity.pose = pose
        sub_scene.add_entity(entity)
        entities.append(entity)
    actor = Actor.create_from_entities(
        entities, scene, torch.arange(len(entities)), shared_name=name
    )
    actor.initial_pose = Pose.create(pose, device=scene.device)
    scene.actors[name] = actor
    scene.add_to_state_dict_registry(actor)
    return actor
