"""The one scene of a CPU task through SAPIEN's raw handles: the quick way past ManiSkill."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import sapien
from numpy.typing import NDArray

from modpush.envs.robot.control import planar_joints_cpu
from modpush.envs.scenes.objects import PushedObject, get_object_of
from modpush.envs.scenes.scenario import Scenario
from modpush.envs.sim import bodies

if TYPE_CHECKING:
    from modpush.envs.sim.task import ClutterPushEnv

__all__ = ["CpuScene"]

_STILL = np.zeros(3, dtype=np.float32)


class CpuScene:
    """Places, steps and reads the bodies of a task with one scene on a CPU.

    ManiSkill's own way goes through torch tensors of one row, each of which costs more than what it
    carries. The same is done here to the same bodies.
    """

    def __init__(self, task: "ClutterPushEnv") -> None:
        self._task = task
        self._scene = task.scene.sub_scenes[0]
        self._robot = task.agent.robot._objs[0]
        self.joints = [joint._objs[0] for joint in task.agent.robot.active_joints]
        """The driven joints, in the order of their targets."""
        self._links = {name: link._objs[0] for name, link in task.agent.robot.links_map.items()}
        self._entities = {name: actor._objs[0] for name, actor in task._actors.items()}
        self._bodies = {name: actor._bodies[0] for name, actor in task._actors.items()}
        # As built, once: read and written again at every reset, they would drift by roundings.
        self._unit_inertia = {
            name: (np.array(body.inertia) / body.mass, np.array(body.cmass_local_pose.q))
            for name, body in self._bodies.items()
        }
        self._no_force = np.zeros(len(self.joints), dtype=np.float32)

    # ------------------------------------------------------------------ placing

    def place(self, scenario: Scenario) -> None:
        """Put object and tool where an episode starts, at rest.

        Raises:
            ValueError: If the arm cannot reach the tool's pose.
        """
        item = get_object_of(self._task.pushed_objects, scenario.pushed_object)
        self._place_object(item, scenario)
        height = item.tool_height + self._task.agent.tool.length
        joints, reachable = planar_joints_cpu(np.array(scenario.tool_pose), height)
        if not reachable:
            raise ValueError(f"Scenario: tool_pose {scenario.tool_pose} is out of the arm's reach.")
        self._robot.qpos = joints.astype(np.float32)
        self._robot.qvel = self._robot.qf = self._no_force

    def _place_object(self, item: PushedObject, scenario: Scenario) -> None:
        # Only what is in play is in the scene, and it is taken out and put in again: a body leaves
        # PhysX's contact cache behind, and the episode does not depend on the one before, to the
        # last bit.
        for entity in self._entities.values():
            if entity.scene is not None:
                self._scene.remove_entity(entity)
        entity, body = self._entities[item.name], self._bodies[item.name]
        self._scene.add_entity(entity)
        x, y, yaw = scenario.object_pose
        entity.pose = bodies.yaw_pose(x, y, item.height / 2, yaw)
        body.linear_velocity = body.angular_velocity = _STILL
        wanted, (unit, axes) = scenario.dynamics, self._unit_inertia[item.name]
        body.mass = wanted.mass
        body.inertia = unit * wanted.mass
        body.cmass_local_pose = sapien.Pose([*wanted.center_of_mass, 0.0], axes)
        material = self._task._object_material
        material.static_friction = material.dynamic_friction = wanted.friction

    # ------------------------------------------------------------------ stepping

    def advance(self, position: list[list[float]], velocity: list[list[float]]) -> None:
        """One control step, given drive targets: what ManiSkill's `step` does to the bodies.

        Args:
            position: For every substep the six joint targets [rad].
            velocity: For every substep the six joint velocities [rad/s].
        """
        step, contacts, joints = self._task.scene.px.step, self._task.contacts, self.joints
        sample_at = contacts.sample_at(len(position))
        contacts.row = [False] * len(contacts.row)
        last: list[float] | None = None
        for substep, (angles, rates) in enumerate(zip(position, velocity, strict=True), start=1):
            for joint, angle in zip(joints, angles, strict=True):
                joint.set_drive_target(angle)
            if rates != last:
                for joint, rate in zip(joints, rates, strict=True):
                    joint.set_drive_velocity_target(rate)
                last = rates
            step()
            if substep in sample_at:
                contacts.read()

    # ------------------------------------------------------------------ reading

    def object_transform(self) -> list[float]:
        """Position [m] and quaternion (w, x, y, z) of the object in play, 7 numbers."""
        pose = self._bodies[self._task.scenarios[0].pushed_object].entity_pose
        return [*pose.p.tolist(), *pose.q.tolist()]

    def link_transforms(self, names: Sequence[str]) -> list[list[float]]:
        """The same for links of the robot."""
        poses = [self._links[name].entity_pose for name in names]
        return [[*pose.p.tolist(), *pose.q.tolist()] for pose in poses]

    def joint_position(self) -> NDArray[np.float32]:
        """`[6]` [rad]."""
        return self._robot.qpos
