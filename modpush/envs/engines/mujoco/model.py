"""The MuJoCo model of an episode: arm, table, pushed object and obstacles, of the library's solids."""

import functools
import math
from collections.abc import Iterable, Sequence

import mujoco
import numpy as np

from modpush.envs.engines.base import (
    CONTACT_GAP,
    FRICTION,
    OBJECT,
    OBSTACLE,
    ROBOT,
    TABLE,
    SceneSpec,
)
from modpush.envs.robot.robot import Robot, Tool
from modpush.envs.robot.urdf import mass_properties
from modpush.envs.scenes.objects import PushedObject
from modpush.envs.scenes.obstacle import OBSTACLE_COLOR, OBSTACLE_MASS, Obstacle
from modpush.envs.scenes.scenario import Scenario
from modpush.geometry.shapes import Primitive, box, prism

_SOLREF = (0.005, 1.0)
_SOLIMP = (0.95, 0.99, 0.001, 0.5, 2.0)
"""Stiffness of contacts. With MuJoCo's default bodies sink in by up to 4 mm instead of 1.5."""

_KINDS = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "prism": mujoco.mjtGeom.mjGEOM_MESH,
}

_ARMATURE = 0.1
"""Inertia of the motors' rotors about the joints' axes [kg m^2], of the order of a real UR5's. Without
it drives with torque limits are unstable at 240 Hz."""
_IMPRATIO = 10.0
"""Stiffness of friction beside that of the normal force. With 1 a pushed object slides along the tool."""
_ARENA = 1 << 22
"""Memory for contacts and constraints [bytes]; a scene needs some hundred kilobytes."""
_SIDES = 32
"""Sides of the prism that stands for an object's cylinder. MuJoCo's own cylinder sinks by up to 12 mm
into the tool where it is squeezed, and the agents solve 0.70 of its episodes instead of all."""
_FREE = mujoco.mjtJoint.mjJNT_FREE
_UNSTOPPABLE = 1e4
"""Mass of an obstacle that moves by itself [kg]. MuJoCo's own moving bodies (`mocap`) have no velocity,
so that contacts would not carry along what they touch."""


def build_model(spec: SceneSpec, scenario: Scenario, item: PushedObject) -> "mujoco.MjModel":
    """Compile the model of an episode in which `item` is pushed, in about a millisecond.

    The bodies are named as the links, `tool`, `tip`, `object` and `obstacle_<i>`; the arm's joints
    come first in `qpos`, then the object, then obstacles that can be moved.
    """
    model = mujoco.MjSpec()
    model.compiler.degree = False
    model.memory = _ARENA
    option = model.option
    option.timestep = 1 / spec.sim_freq
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = _IMPRATIO
    # What goes wrong must be seen, instead of MuJoCo beginning again at the model's start.
    option.disableflags = mujoco.mjtDisableBit.mjDSBL_AUTORESET
    table = model.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=(3.0, 3.0, 0.1))
    _set_contact([table], TABLE, OBJECT | OBSTACLE, FRICTION["table"])
    _add_arm(model, spec.robot, spec.tool, scenario.dynamics.friction)
    _add_object(model, item, scenario)
    for i, obstacle in enumerate(scenario.obstacles):
        _add_obstacle(model, i, obstacle, spec.dynamic_obstacles or obstacle.motion is not None)
    _exclude_pairs(model, scenario.obstacles, spec.dynamic_obstacles)
    return model.compile()


def _mean(a: float, b: float) -> float:
    return (a + b) / 2


def _add_arm(model: "mujoco.MjSpec", robot: Robot, tool: Tool, object_friction: float) -> None:
    """The arm's links from its base to the tip of its tool, and its drives."""
    friction = _mean(FRICTION["tool"], object_friction)
    first, *others = robot.links
    body = model.worldbody.add_body(name=first.name, pos=robot.base)
    # The base stands on the table without touching it.
    _fill_link(model, body, first.mass, first.shapes, OBJECT | OBSTACLE, friction)
    for link, joint in zip(others, robot.joints, strict=True):
        body = body.add_body(name=link.name, pos=joint.position, quat=_quaternion(joint.rpy))
        body.add_joint(
            name=joint.name,
            axis=joint.axis,
            limited=mujoco.mjtLimited.mjLIMITED_TRUE,
            range=joint.limits,
            armature=_ARMATURE,
        )
        _fill_link(model, body, link.mass, link.shapes, OBJECT | OBSTACLE | TABLE, friction)
    place, turn = robot.flange_position, _quaternion(robot.flange_rpy)
    body = body.add_body(name="tool", pos=place, quat=turn)
    _fill_link(model, body, tool.mass, tool.shapes, OBJECT | OBSTACLE | TABLE, friction)
    body.add_body(name="tip", pos=(0.0, 0.0, tool.length))
    for joint in robot.joints:
        _add_drive(model, robot, joint.name, joint.effort)


def _fill_link(
    model: "mujoco.MjSpec",
    body: "mujoco.MjsBody",
    mass: float,
    shapes: tuple[Primitive, ...],
    against: int,
    friction: float,
) -> None:
    center, diagonal = mass_properties(mass, shapes)
    _set_inertia(body, mass, center, diagonal)
    body.gravcomp = 1.0  # the drives of an arm compensate its weight
    # Above the object's, since a pair with the tool has less friction than others.
    _set_contact(_add_solids(model, body, shapes), ROBOT, against, friction, priority=2)


def _add_drive(model: "mujoco.MjSpec", robot: Robot, joint: str, limit: float) -> None:
    """A drive with torque `stiffness (q* - q) + damping (v* - v)`, whose input is q* + v* d / s."""
    drive = model.add_actuator(name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    drive.gaintype, drive.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
    drive.gainprm[0] = robot.stiffness
    drive.biasprm[:3] = (0.0, -robot.stiffness, -robot.damping)
    drive.forcelimited, drive.forcerange = mujoco.mjtLimited.mjLIMITED_TRUE, (-limit, limit)


def _add_object(model: "mujoco.MjSpec", item: PushedObject, scenario: Scenario) -> None:
    x, y, yaw = scenario.object_pose
    dynamics = scenario.dynamics
    body = model.worldbody.add_body(name="object", pos=(x, y, item.height / 2), quat=_yaw(yaw))
    body.add_joint(type=_FREE)
    unit_inertia, quaternion, height = _homogeneous(item)
    center = (*dynamics.center_of_mass, height)
    _set_inertia(body, dynamics.mass, center, dynamics.mass * unit_inertia, quaternion)
    friction = _mean(dynamics.friction, FRICTION["table"])  # obstacles have the table's
    geoms = _add_solids(model, body, map(_many_sided, item.parts))
    _set_contact(geoms, OBJECT, ROBOT | OBSTACLE | TABLE, friction, priority=1)


def _many_sided(part: Primitive) -> Primitive:
    """A prism instead of a cylinder; any other solid as it is."""
    if part.kind != "cylinder":
        return part
    radius, half, _ = part.size
    angles = np.arange(_SIDES) * (2 * math.pi / _SIDES)
    corners = radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    outline = tuple((float(x), float(y)) for x, y in corners)
    return prism(outline, 2 * half, position=part.position, color=part.color)


@functools.lru_cache(maxsize=1024)
def _homogeneous(item: PushedObject) -> tuple[np.ndarray, np.ndarray, float]:
    """Principal inertia [m^2] and axes of an object of 1 kg, and height of its centre of mass [m]."""
    model = mujoco.MjSpec()
    body = model.worldbody.add_body(name="object")
    body.add_joint(type=_FREE)
    for geom in _add_solids(model, body, item.parts):
        geom.density = 1000.0
    made = model.compile()
    return (
        made.body_inertia[1] / made.body_mass[1],
        made.body_iquat[1].copy(),
        round(float(made.body_ipos[1, 2]), 6),
    )


def _add_obstacle(model: "mujoco.MjSpec", index: int, obstacle: Obstacle, movable: bool) -> None:
    x, y, yaw = obstacle.pose
    body = model.worldbody.add_body(
        name=f"obstacle_{index}", pos=(x, y, obstacle.size[2] / 2), quat=_yaw(yaw)
    )
    geoms = _add_solids(model, body, [box(*obstacle.size, color=OBSTACLE_COLOR)])
    if movable:
        body.add_joint(type=_FREE)
        square = np.square(obstacle.size)
        mass = OBSTACLE_MASS if obstacle.motion is None else _UNSTOPPABLE
        _set_inertia(body, mass, (0.0, 0.0, 0.0), mass * (square.sum() - square) / 12)
    if obstacle.motion is not None:
        body.gravcomp = 1.0
    _set_contact(geoms, OBSTACLE, ROBOT | OBJECT | TABLE | OBSTACLE, FRICTION["obstacle"])


def _exclude_pairs(model: "mujoco.MjSpec", obstacles: Sequence[Obstacle], movable: bool) -> None:
    """Let obstacles that move by themselves pass over the table and through whatever cannot be pushed."""
    for i, one in enumerate(obstacles):
        if one.motion is not None:
            model.add_exclude(bodyname1="world", bodyname2=f"obstacle_{i}")
            for k, other in enumerate(obstacles):
                if (other.motion is None and not movable) or (other.motion is not None and k < i):
                    names = f"obstacle_{i}", f"obstacle_{k}"
                    model.add_exclude(bodyname1=names[0], bodyname2=names[1])


def _set_inertia(
    body: "mujoco.MjsBody",
    mass: float,
    center: Sequence[float],
    principal: "Sequence[float] | np.ndarray",
    quaternion: "Sequence[float] | np.ndarray" = (1.0, 0.0, 0.0, 0.0),
) -> None:
    body.explicitinertial = True
    body.mass, body.ipos, body.iquat, body.inertia = mass, center, quaternion, principal


def _yaw(angle: float) -> tuple[float, float, float, float]:
    return math.cos(angle / 2), 0.0, 0.0, math.sin(angle / 2)


def _quaternion(rpy: tuple[float, float, float]) -> tuple[float, float, float, float]:
    """Of fixed-axis roll, pitch and yaw [rad]."""
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(a / 2), math.sin(a / 2)) for a in rpy)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def _add_solids(
    spec: "mujoco.MjSpec", body: "mujoco.MjsBody", parts: Iterable[Primitive]
) -> "list[mujoco.MjsGeom]":
    """Add the solids of a body as geoms that collide with nothing yet; prisms are meshes."""
    geoms = []
    for i, part in enumerate(parts):
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, part.rotation().ravel())
        geom = body.add_geom(
            type=_KINDS[part.kind], size=part.size, pos=part.position, quat=quaternion
        )
        geom.contype = geom.conaffinity = 0
        geom.rgba = (*part.color, 1.0)
        if part.kind == "prism":
            geom.meshname = f"{body.name}_{i}"
            spec.add_mesh(name=geom.meshname, uservert=_corners(part))
        geoms.append(geom)
    return geoms


def _corners(part: Primitive) -> np.ndarray:
    """Corners of a prism, `[2 n * 3]` [m]."""
    outline, half = np.array(part.outline), part.size[2]
    return np.concatenate([np.insert(outline, 2, z, axis=1) for z in (-half, half)]).ravel()


def _set_contact(
    geoms: "Iterable[mujoco.MjsGeom]",
    category: int,
    against: int,
    friction: float,
    priority: int = 0,
) -> None:
    """Say what geoms collide with: a sum of categories. The friction of a pair is that of the geom with
    the higher priority, or the larger of two.
    """
    for geom in geoms:
        geom.contype, geom.conaffinity = category, against
        geom.friction[0], geom.priority = friction, priority
        geom.solref, geom.solimp = _SOLREF, _SOLIMP
        # The gaps of two geoms add up. A margin would do more: forces begin there, so that bodies float.
        geom.gap = CONTACT_GAP / 2
