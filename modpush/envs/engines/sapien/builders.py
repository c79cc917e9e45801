"""Common parts of all scenes: simulation settings, materials, table, goal marker and cameras."""

import numpy as np
import sapien
from mani_skill.envs.scene import ManiSkillScene
from mani_skill.sensors.camera import CameraConfig
from mani_skill.utils.sapien_utils import look_at
from mani_skill.utils.structs import Actor, Articulation, Link
from mani_skill.utils.structs.types import SceneConfig, SimConfig
from sapien import physx

from modpush.envs.engines.base import FRICTION
from modpush.envs.engines.sapien import bodies
from modpush.envs.engines.sapien.object_bodies import add_to_group
from modpush.envs.engines.sapien.rendering import camera_pose
from modpush.geometry.camera import CAMERA
from modpush.geometry.shapes import box


def camera_from_above() -> CameraConfig:
    """The observing bird's-eye camera."""
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
    """The camera that `render` shows pictures from, 512 x 512."""
    pose = look_at([1.35, 0.75, 0.85], [0.40, 0.0, 0.05]).sp
    return CameraConfig("render_camera", pose, 512, 512, 0.75, 0.01, 10.0, shader_pack="default")


def simulation_config(sim_freq: int, control_freq: int) -> SimConfig:
    """Settings of the simulation, for physics steps and actions per second."""
    return SimConfig(
        sim_freq=sim_freq,
        control_freq=control_freq,
        spacing=3,
        # A small contact offset keeps the number of contact pairs small; the fastest body moves
        # 2.5 mm in a physics step. With 8 solver iterations instead of ManiSkill's 15, a squeezed
        # object sank 3.9 mm into an obstacle once in 10 minutes of random actions.
        scene_config=SceneConfig(contact_offset=0.005, solver_position_iterations=15),
    )


def make_material(name: str) -> physx.PhysxMaterial:
    """A material without restitution, by its name in `FRICTION`."""
    return physx.PhysxMaterial(FRICTION[name], FRICTION[name], 0.0)


def set_material(robot: Articulation, material: physx.PhysxMaterial) -> None:
    """Give all collision shapes of a robot one material."""
    for link in robot.links:
        for raw in link._objs:
            for shape in raw.collision_shapes:
                shape.physical_material = material


def build_table(scene: ManiSkillScene, robot_base: Link, material: physx.PhysxMaterial) -> None:
    """Build an endless plane that bodies rest on but the robot's base, and a table top that is seen."""
    for i, sub_scene in enumerate(scene.sub_scenes):
        entity = sapien.Entity()
        if i == 0 or not scene.gpu_sim_enabled:  # one plane serves all GPU scenes
            body = physx.PhysxRigidStaticComponent()
            plane = physx.PhysxCollisionShapePlane(material)
            plane.local_pose = sapien.Pose(q=[np.sqrt(0.5), 0, -np.sqrt(0.5), 0])
            _never_touch_base(plane)
            add_to_group(plane)
            body.attach(plane)
            entity.add_component(body)
        if scene.can_render():
            top = box(3.0, 3.0, 0.04, (0.6, 0.0, -0.02), color=(0.93, 0.91, 0.87))
            bodies.attach_visuals(entity, [top])
        entity.name = f"scene-{i}_table"
        sub_scene.add_entity(entity)
    for raw in robot_base._objs:
        for shape in raw.collision_shapes:
            _never_touch_base(shape)


def _never_touch_base(shape: physx.PhysxCollisionShape) -> None:
    """Set a bit of the collision group; two shapes that both have it never collide."""
    groups = list(shape.collision_groups)
    groups[2] |= 1 << 30
    shape.set_collision_groups(groups)


def build_goal_marker(scene: ManiSkillScene, radius: float) -> Actor:
    """Build a disc of the goal's size [m] for pictures; the task hides it from its sensors."""
    builder = scene.create_actor_builder()
    builder.add_cylinder_visual(
        pose=sapien.Pose(q=[np.sqrt(0.5), 0, np.sqrt(0.5), 0]),
        radius=radius,
        half_length=0.0005,
        material=sapien.render.RenderMaterial(base_color=[0.1, 0.75, 0.2, 1.0]),
    )
    builder.initial_pose = sapien.Pose([0.5, 0.0, 0.0])
    marker = builder.build_kinematic("goal")
    scene.remove_from_state_dict_registry(marker)
    return marker
