"""`SapienEngine`: one scene on a CPU through SAPIEN's own handles."""

from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING, ClassVar

import numpy as np
import sapien
import torch
from mani_skill.utils.structs import Pose
from numpy.typing import NDArray
from sapien import physx

from modpush.envs.engines.base import (
    ENGINES,
    Engine,
    SceneSpec,
    check_quaternions,
    check_vector,
)
from modpush.envs.engines.sapien import bodies
from modpush.envs.engines.sapien.object_bodies import attach_feet, stand_on_feet
from modpush.envs.scenes.objects import PushedObject
from modpush.envs.scenes.scenario import Scenario

if TYPE_CHECKING:
    from modpush.envs.engines.sapien.task import PushTask

_STILL = np.zeros(3, dtype=np.float32)
_BODY = 13  # numbers of a body's packed state: quaternion, position, linear and angular velocity
_JOINT = 4  # numbers of a joint's: angle, rate, and the drive's targets of both
_LARGEST = 1e4  # of a state that a simulation can have been in [m, m/s, rad/s]


class SapienEngine(Engine):
    """Places, steps and reads the bodies of one scene on a CPU, which a task has built.

    ManiSkill's own functions work on torch tensors of one row, each of which costs more than the numbers
    it carries. This class does the same to the same bodies.
    """

    name: ClassVar = "sapien"
    version: ClassVar = sapien.__version__
    default_sim_freq: ClassVar = ENGINES["sapien"].sim_freq

    def __init__(self, task: "PushTask") -> None:
        self.task, self._scene, self._objects = task, task.scene, task.objects
        self._obstacles, self._contacts = task.obstacles, task.contacts
        robot = task.agent.robot
        joints = [joint._objs[0] for joint in robot.active_joints]
        # Looked up once: these are called some fifty times a step.
        self._drives = [(j.set_drive_target, j.set_drive_velocity_target) for j in joints]
        self._robot = robot._objs[0]
        self._links = {name: link._objs[0] for name, link in robot.links_map.items()}
        self._entities = {name: actor._objs[0] for name, actor in self._objects.actors.items()}
        self._bodies = {name: actor._bodies[0] for name, actor in self._objects.actors.items()}
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
        # Of those that have had a shifted centre of mass; the others have none, and behave as ever.
        self._feet: dict[str, list[physx.PhysxCollisionShape]] = {}
        # SAPIEN builds a camera that changes its scene anew, with the shaders that are set then.
        self._camera_scenes: list[sapien.Scene] = []
        self._no_force = np.zeros(len(joints), dtype=np.float32)

    @classmethod
    def build(cls, spec: SceneSpec) -> "SapienEngine":
        """The engine of a new scene.

        Raises:
            RuntimeError: If a renderer is needed and there is none.
        """
        from modpush.envs.engines.sapien.task import PushTask

        engine = PushTask(spec).engine
        assert engine is not None
        return engine

    def load(self, scenario: Scenario, joints: NDArray[np.float32]) -> None:
        """See `Engine`. Arm and table move into a new PhysX scene, which costs 0.3 ms.

        A PhysX scene remembers more than its bodies' states: cached contacts, and lists of free
        identifiers, by which it orders the contacts that it solves. In a new one an episode depends
        on nothing that was before, to the last bit.
        """
        item = self._objects.item(scenario.pushed_object)
        self.task._set_scene_config()  # SAPIEN's settings are global: others may have changed them
        self._renew()
        self._obstacles.place(scenario.obstacles)
        if self.task.marker is not None:
            goal = torch.tensor([[*scenario.goal_position, 0.0005]])
            self.task.marker.set_pose(Pose.create_from_pq(goal))
        self._place_object(item, scenario)
        self._robot.qpos = joints
        self._robot.qvel = self._robot.qf = self._no_force
        self._contacts.reset()

    def _renew(self) -> None:
        """Move all bodies that stay into a new PhysX scene; object and obstacles are left out."""
        old = self._scene.sub_scenes[0]
        for entity in (*self._entities.values(), *self._obstacles.entities()):
            if entity.scene is not None:
                old.remove_entity(entity)
        body = physx.PhysxBaseComponent
        staying = [one for one in old.entities if one.find_component_by_type(body)]  # in order
        for entity in staying:
            old.remove_entity(entity)
        system = physx.PhysxCpuSystem()
        system.timestep = self._scene.px.timestep
        kept = [old.render_system] if self._scene.can_render() else []
        new = sapien.Scene([system, *kept])
        for entity in staying:
            new.add_entity(entity)
        if old.entities:
            self._camera_scenes.append(old)
        self._scene.sub_scenes[0], self._scene.px = new, system

    def _place_object(self, item: PushedObject, scenario: Scenario) -> None:
        entity, body = self._entities[item.name], self._bodies[item.name]
        shifted = any(scenario.dynamics.center_of_mass)
        if shifted and item.name not in self._feet:
            self._feet[item.name] = attach_feet(body, item.parts, self._objects.material)
        stand_on_feet(self._feet.get(item.name, []), shifted)
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

    def advance(
        self,
        position: Sequence[Sequence[float]],
        velocity: Sequence[Sequence[float]],
        looks: Collection[int],
        obstacles: NDArray[np.float64] | None = None,
    ) -> list[bool]:
        """See `Engine`: what ManiSkill's `step` does to the bodies."""
        step, contacts, drives = self._scene.px.step, self._contacts, self._drives
        contacts.clear()
        last: Sequence[float] | None = None
        for substep, (angles, rates) in enumerate(zip(position, velocity, strict=True), start=1):
            for (set_angle, _), angle in zip(drives, angles, strict=True):
                set_angle(angle)
            if rates != last:
                for (_, set_rate), rate in zip(drives, rates, strict=True):
                    set_rate(rate)
                last = rates
            if obstacles is not None:
                self._obstacles.move(obstacles[substep - 1].tolist())
            step()
            if substep in looks:
                contacts.read()
        return contacts.touched

    def joint_position(self) -> NDArray[np.float32]:
        return self._robot.qpos

    def object_transform(self) -> list[float]:
        pose = self._pushed_body.entity_pose
        return [*pose.p.tolist(), *pose.q.tolist()]

    def obstacle_transforms(self) -> NDArray[np.float64]:
        return self._obstacles.transforms()

    def link_transforms(self, names: Sequence[str]) -> list[list[float]]:
        poses = [self._links[name].entity_pose for name in names]
        return [[*pose.p.tolist(), *pose.q.tolist()] for pose in poses]

    def gaps(self) -> dict[str, float]:
        return self._contacts.gaps()

    def pack(self) -> NDArray[np.float32]:
        """See `Engine`. PhysX's contact cache is not in it, nor the velocities of kinematic bodies.

        PhysX does not restore these: it takes them from the places where the bodies go next.
        """
        packed = np.frombuffer(self._scene.px.pack(), dtype=np.float32)
        if kinematic := self._obstacles.kinematic_rows():
            packed = packed.copy()
            for row in kinematic:  # after the object, which is the oldest body
                packed[_BODY * (1 + row) + 7 : _BODY * (2 + row)] = 0.0
        return packed

    def unpack(self, packed: NDArray[np.float32]) -> None:
        self._scene.px.unpack(packed.tobytes())

    def check_packed(self, packed: NDArray[np.float32], scenario: Scenario) -> None:
        """See `Engine`; PhysX itself checks nothing."""
        pushed = self.task.scene_spec.dynamic_obstacles
        movable = sum(pushed or o.motion is not None for o in scenario.obstacles)
        num_bodies = 2 + movable  # with the object and the arm's base
        size = _BODY * num_bodies + _JOINT * len(self._drives)
        check_vector(packed, size)
        if not (np.abs(packed) <= _LARGEST).all():  # False for NaN
            raise ValueError(
                f"SceneState: physics must be finite and at most {_LARGEST:g}, "
                f"got {packed[~(np.abs(packed) <= _LARGEST)][0]}."
            )
        check_quaternions(packed[: _BODY * num_bodies].reshape(-1, _BODY)[:, :4])

    def picture(self) -> NDArray[np.uint8] | None:
        if not self._scene.can_render():
            return None
        return self.task.render_rgb_array()[0].cpu().numpy()

    def close(self) -> None:
        """Nothing: the scene is freed with its last reference.

        ManiSkill's own `close` would collect garbage while the task still holds its bodies.
        """
