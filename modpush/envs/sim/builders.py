"""The standing parts of the task's scenes: table, goal marker, pushed objects, the view from the side."""

from typing import TYPE_CHECKING

import numpy as np
import sapien
import torch
from mani_skill.sensors.camera import CameraConfig
from mani_skill.utils.structs import Actor, Pose
from sapien import physx
from transforms3d.quaternions import mat2quat

from modpush.envs.scenes.objects import PushedObject
from modpush.envs.sim import bodies
from modpush.envs.sim.rendering import camera_pose
from modpush.geometry.camera import CAMERA
from modpush.geometry.shapes import box

if TYPE_CHECKING:
    from modpush.envs.sim.task import ClutterPushEnv

__all__ = [
    "build_goal_marker",
    "build_object",
    "build_table",
    "camera_from_above",
    "camera_from_the_side",
    "parking_pose",
]

_PARKED = (20.0, 0.0)  # where objects that are not in play rest [m]


def camera_from_above() -> CameraConfig:
    """The observing camera, as ManiSkill's."""
    return CameraConfig(
        uid="bird_eye",
        pose=camera_pose(CAMERA),
        width=CAMERA.width,
        height=CAMERA.height,
        fov=CAMERA.field_of_view,
        near=0.01,
        far=10.0,
    )


def camera_from_the_side() -> CameraConfig:
    """The camera for people, 512 x 512."""
    pose = sapien.Pose([1.35, 0.75, 0.85])
    pose.q = _look_along(np.array([0.40, 0.0, 0.05]) - pose.p)
    return CameraConfig("render_camera", pose, 512, 512, 0.75, 0.01, 10.0, shader_pack="default")


def _look_along(forward: np.ndarray) -> np.ndarray:
    """Quaternion of a camera that looks along a direction, upright."""
    x = forward / np.linalg.norm(forward)
    y = np.cross([0.0, 0.0, 1.0], x)
    y /= np.linalg.norm(y)
    return mat2quat(np.stack([x, y, np.cross(x, y)], 1))


def build_table(task: "ClutterPushEnv", material: physx.PhysxMaterial) -> None:
    """An endless plane to rest on, and a table top to see."""
    for i, sub_scene in enumerate(task.scene.sub_scenes):
        entity = sapien.Entity()
        if i == 0 or not task.gpu_sim_enabled:  # one plane serves all GPU scenes
            body = physx.PhysxRigidStaticComponent()
            plane = physx.PhysxCollisionShapePlane(material)
            plane.local_pose = sapien.Pose(q=[np.sqrt(0.5), 0, -np.sqrt(0.5), 0])
            _never_touch_base(plane)
            body.attach(plane)
            entity.add_component(body)
        if task.scene.can_render():
            top = box(3.0, 3.0, 0.04, (0.6, 0.0, -0.02), color=(0.93, 0.91, 0.87))
            bodies.attach_visuals(entity, [top])
        entity.name = f"scene-{i}_table"
        sub_scene.add_entity(entity)
    for raw in task.agent.robot.links_map["base"]._objs:
        for shape in raw.collision_shapes:
            _never_touch_base(shape)


def _never_touch_base(shape: physx.PhysxCollisionShape) -> None:
    """Two shapes with this bit never collide: the robot's base stands on the table for good."""
    groups = list(shape.collision_groups)
    groups[2] |= 1 << 30
    shape.set_collision_groups(groups)


def build_goal_marker(task: "ClutterPushEnv") -> Actor:
    """A disc of the goal's size, for people: cameras that make observations do not see it."""
    builder = task.scene.create_actor_builder()
    builder.add_cylinder_visual(
        pose=sapien.Pose(q=[np.sqrt(0.5), 0, np.sqrt(0.5), 0]),
        radius=task.goal_threshold,
        half_length=0.0005,
        material=sapien.render.RenderMaterial(base_color=[0.1, 0.75, 0.2, 1.0]),
    )
    builder.initial_pose = sapien.Pose([0.5, 0.0, 0.0])
    marker = builder.build_kinematic("goal")
    task.scene.remove_from_state_dict_registry(marker)
    task._hidden_objects.append(marker)
    return marker


def build_object(
    task: "ClutterPushEnv", item: PushedObject, material: physx.PhysxMaterial
) -> Actor:
    """One body of this kind per scene, with mass and inertia of a homogeneous solid, parked."""
    entities, pose = [], parking_pose(task.pushed_objects, item)
    for i, sub_scene in enumerate(task.scene.sub_scenes):
        entity = bodies.rigid_body(item.parts, material, mass=item.mass)
        if task.scene.can_render():
            bodies.attach_visuals(entity, item.parts)
        entity.name = f"scene-{i}_{item.name}"
        entity.pose = pose
        sub_scene.add_entity(entity)
        entities.append(entity)
    actor = Actor.create_from_entities(
        entities, task.scene, torch.arange(task.num_envs), shared_name=item.name
    )
    actor.initial_pose = Pose.create(pose, device=task.device)
    task.scene.actors[item.name] = actor
    task.scene.add_to_state_dict_registry(actor)
    return actor


def parking_pose(items: list[PushedObject], item: PushedObject) -> sapien.Pose:
    """Where an object rests while another one is in play."""
    index = [other.name for other in items].index(item.name)
    return bodies.yaw_pose(_PARKED[0], _PARKED[1] + index, item.height / 2, 0.0)
