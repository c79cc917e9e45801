"""SAPIEN bodies made of primitives: collision shapes, and visuals where there is a renderer."""

import functools
import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import sapien
import torch
import trimesh
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
        if part.kind == "prism":
            scale = np.ones(3, dtype=np.float32)
            shape = physx.PhysxCollisionShapeConvexMesh(_prism_vertices(part), scale, material)
        else:
            shape = _COLLISION_SHAPES[part.kind](*_dimensions(part), material=material)
        shape.local_pose = _local_pose(part)
        shapes.append(shape)
    return shapes


_COLLISION_SHAPES = {
    "box": physx.PhysxCollisionShapeBox,
    "cylinder": physx.PhysxCollisionShapeCylinder,
    "capsule": physx.PhysxCollisionShapeCapsule,
}


def _dimensions(part: Primitive) -> tuple[Any, ...]:
    """Half sizes of a box; radius and half length of a cylinder and a capsule [m]."""
    return (part.size,) if part.kind == "box" else part.size[:2]


def attach_visuals(entity: sapien.Entity, parts: Iterable[Primitive]) -> None:
    """Draw a body's parts. Call it only where there is a renderer: SAPIEN raises otherwise."""
    component = sapien.render.RenderBodyComponent()
    for part in parts:
        material = sapien.render.RenderMaterial(
            base_color=[*part.color, 1.0], roughness=0.6, specular=0.3
        )
        if part.kind == "prism":
            shape = _prism_visual(part, material)
        else:
            draw = getattr(sapien.render, f"RenderShape{part.kind.capitalize()}")
            shape = draw(*_dimensions(part), material)
        shape.local_pose = _local_pose(part)
        component.attach(shape)
    entity.add_component(component)


def _prism_visual(
    part: Primitive, material: "sapien.render.RenderMaterial"
) -> "sapien.render.RenderShapeTriangleMesh":
    """A prism with flat faces: every face has its own vertices, so that normals are its own."""
    hull = trimesh.convex.convex_hull(_prism_vertices(part))
    hull.unmerge_vertices()
    return sapien.render.RenderShapeTriangleMesh(
        hull.vertices.astype(np.float32),
        hull.faces.astype(np.uint32),
        np.repeat(hull.face_normals, 3, axis=0).astype(np.float32),
        np.zeros((len(hull.vertices), 2), dtype=np.float32),
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
