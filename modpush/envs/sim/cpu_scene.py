"""The one scene of a CPU task through SAPIEN's own handles, which is faster than through ManiSkill."""

from collections.abc import Iterable, Sequence

import numpy as np
import sapien
from mani_skill.envs.scene import ManiSkillScene
from mani_skill.utils.structs import Articulation
from numpy.typing import NDArray
from sapien import physx

from modpush.envs.robot.control_cpu import planar_joints_cpu
from modpush.envs.scenes.objects import PushedObject
from modpush.envs.scenes.scenario import Scenario
from modpush.envs.sim import bodies
from modpush.envs.sim.contacts import CpuContacts
from modpush.envs.sim.object_bodies import ObjectBodies

__all__ = ["CpuScene"]

_STILL = np.zeros(3, dtype=np.float32)


class CpuScene:
    """Places, steps and reads the bodies of one scene on a CPU.

    ManiSkill's own functions work on torch tensors of one row, each of which costs more than the
    numbers it carries. This class does the same to the same bodies.

    Args:
        scene: ManiSkill's scene, with one sub-scene.
        robot: The robot.
        tool_length: Length of its tool from the flange to the tip [m].
        objects: The objects that may be pushed.
        contacts: Reads the contacts during `advance`.
    """

    def __init__(
        self,
        scene: ManiSkillScene,
        robot: Articulation,
        tool_length: float,
        objects: ObjectBodies,
        contacts: CpuContacts,
    ) -> None:
        self.contacts = contacts
        self.joints = [joint._objs[0] for joint in robot.active_joints]
        """The driven joints, in the order of their targets."""
        self._scene = scene
        self._robot = robot._objs[0]
        self._links = {name: link._objs[0] for name, link in robot.links_map.items()}
        self._tool_length = tool_length
        self._objects = objects
        self._entities = {name: actor._objs[0] for name, actor in objects.actors.items()}
        self._bodies = {name: actor._bodies[0] for name, actor in objects.actors.items()}
        self._pushed_body = next(iter(self._bodies.values()))
        # As built, once: read and written again at every reset, they would drift by roundings.
        self._unit_inertia = {
            name: (np.array(body.inertia) / body.mass, np.array(body.cmass_local_pose.q))
            for name, body in self._bodies.items()
        }
        # To a micrometre: in the middle but for roundings is in the middle.
        self._height_of_mass = {
            name: round(float(body.cmass_local_pose.p[2]), 6) for name, body in self._bodies.items()
        }
        # SAPIEN builds a camera that changes its scene anew, with the shaders that are set then.
        self._camera_scenes: list[sapien.Scene] = []
        self._no_force = np.zeros(len(self.joints), dtype=np.float32)

    @property
    def physics(self) -> physx.PhysxCpuSystem:
        """PhysX's system of the present episode."""
        return self._scene.px

    def renew(self, scenario: Scenario, obstacles: Iterable[sapien.Entity]) -> None:
        """Move the arm, the table and all other bodies that stay into a new PhysX scene.

        A PhysX scene remembers more than its bodies' states: cached contacts, and lists of free
        identifiers, by which it orders the contacts that it solves. In a new one an episode depends
        on nothing that was before, to the last bit. It costs 0.3 ms.

        Args:
            scenario: What the next episode starts from; it is checked before anything changes.
            obstacles: Obstacles of the last episode, which are left out, as the objects are.

        Raises:
            ValueError: If the arm cannot reach the tool's pose, or if there is no such object.
        """
        self.start_joints(scenario)
        old = self._scene.sub_scenes[0]
        for entity in (*self._entities.values(), *obstacles):
            if entity.scene is not None:
                old.remove_entity(entity)
        staying = [entity for entity in old.entities if _has_body(entity)]  # in their old order
        for entity in staying:
            old.remove_entity(entity)
        system = physx.PhysxCpuSystem()
        system.timestep = self.physics.timestep
        kept = [old.render_system] if self._scene.can_render() else []
        new = sapien.Scene([system, *kept])
        for entity in staying:
            new.add_entity(entity)
        if old.entities:
            self._camera_scenes.append(old)
        self._scene.sub_scenes[0], self._scene.px = new, system

    def start_joints(self, scenario: Scenario) -> NDArray[np.float32]:
        """Angles of the joints at the start of an episode, `[6]` [rad].

        Raises:
            ValueError: If the arm cannot reach the tool's pose, or if there is no such object.
        """
        height = self._objects.item(scenario.pushed_object).tool_height + self._tool_length
        joints, reachable = planar_joints_cpu(np.array(scenario.tool_pose), height)
        if not reachable:
            raise ValueError(
                f"Scenario: tool_pose must not be out of the arm's reach, got {scenario.tool_pose}."
            )
        return joints.astype(np.float32)

    def place(self, scenario: Scenario) -> None:
        """Put object and tool where an episode starts, at rest, in a scene from `renew`.

        Raises:
            ValueError: If the arm cannot reach the tool's pose, or if there is no such object.
        """
        joints = self.start_joints(scenario)
        self._place_object(self._objects.item(scenario.pushed_object), scenario)
        self._robot.qpos = joints
        self._robot.qvel = self._robot.qf = self._no_force

    def _place_object(self, item: PushedObject, scenario: Scenario) -> None:
        entity, body = self._entities[item.name], self._bodies[item.name]
        self._scene.sub_scenes[0].add_entity(entity)
        body.linear_velocity = body.angular_velocity = _STILL
        body.wake_up()  # the time that it had been almost at rest would count on
        wanted, (unit, axes) = scenario.dynamics, self._unit_inertia[item.name]
        body.mass = wanted.mass
        body.inertia = unit * wanted.mass
        center = [*wanted.center_of_mass, self._height_of_mass[item.name]]
        body.cmass_local_pose = sapien.Pose(center, axes)
        # After the centre of mass: PhysX keeps the pose of that, and moving it rounds by where it was.
        x, y, yaw = scenario.object_pose
        entity.pose = bodies.yaw_pose(x, y, item.height / 2, yaw)
        material = self._objects.material
        material.static_friction = material.dynamic_friction = wanted.friction
        self._pushed_body = body

    def advance(self, position: list[list[float]], velocity: list[list[float]]) -> None:
        """Take one control step, given drive targets: what ManiSkill's `step` does to the bodies.

        Args:
            position: For every substep the six joint targets [rad].
            velocity: For every substep the six joint velocities [rad/s].
        """
        step, contacts, joints = self.physics.step, self.contacts, self.joints
        sampled = contacts.sampled_substeps(len(position))
        contacts.clear()
        last: list[float] | None = None
        for substep, (angles, rates) in enumerate(zip(position, velocity, strict=True), start=1):
            for joint, angle in zip(joints, angles, strict=True):
                joint.set_drive_target(angle)
            if rates != last:
                for joint, rate in zip(joints, rates, strict=True):
                    joint.set_drive_velocity_target(rate)
                last = rates
            step()
            if substep in sampled:
                contacts.read()

    def object_transform(self) -> list[float]:
        """Position [m] and quaternion (w, x, y, z) of the pushed object, 7 numbers."""
        pose = self._pushed_body.entity_pose
        return [*pose.p.tolist(), *pose.q.tolist()]

    def link_transforms(self, names: Sequence[str]) -> list[list[float]]:
        """Position [m] and quaternion (w, x, y, z) of links of the robot, 7 numbers each."""
        poses = [self._links[name].entity_pose for name in names]
        return [[*pose.p.tolist(), *pose.q.tolist()] for pose in poses]

    def joint_position(self) -> NDArray[np.float32]:
        """Angles of the driven joints, `[6]` [rad]."""
        return self._robot.qpos


def _has_body(entity: sapien.Entity) -> bool:
    return any(isinstance(part, physx.PhysxBaseComponent) for part in entity.components)
