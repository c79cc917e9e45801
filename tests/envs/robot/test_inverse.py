"""The inverse kinematics of every robot, against the chain of its joints and a peer's."""

import math
from dataclasses import replace

import numpy as np
import pytest
import pytorch_kinematics
import torch
from scipy.spatial.transform import Rotation

from modpush.envs.robot.least_squares import DampedLeastSquares
from modpush.envs.robot.named import ROBOTS, TOOLS
from modpush.envs.robot.robot import Joint
from modpush.envs.robot.universal_robots import ThreeParallelAxes
from modpush.envs.robot.urdf import urdf_text
from modpush.geometry.shapes import rpy_matrix

HEIGHT = 0.02 + 0.163
UR = [name for name in ROBOTS if name.startswith("ur")]
# Of the UR5 before other robots: x, y, z, yaw of the flange and the angles that hold it there.
GOLDEN = {
    (0.5, 0.1, 0.183, 0.3): (
        0.4131257618773403,
        -1.7894804138641025,
        -2.006451441684807,
        -0.9164571248357802,
        1.5707963267948966,
        -1.4576705649175563,
    ),
    (0.2, -0.3, 0.175, -2.0): (
        -0.6752404432255821,
        -1.4528855348463394,
        -2.3927594380681803,
        -0.86674400747017,
        1.5707963267948966,
        -0.24603677002047863,
    ),
}


def with_turned_frames(robot):
    """The same arm, its joints' frames turned, so that they turn about other axes than z."""
    turns = Rotation.random(len(robot.joints), rng=np.random.default_rng(0))
    turns[1] = Rotation.from_euler("x", math.pi)  # about -z
    joints, back = [], Rotation.identity()
    places = [*robot.joints, Joint(name="flange", limits=(0, 1), effort=1.0)]
    places[-1] = replace(places[-1], position=robot.flange_position, rpy=robot.flange_rpy)
    for joint, turn in zip(places, [*turns, Rotation.identity()], strict=True):
        frame = back * Rotation.from_matrix(rpy_matrix(joint.rpy)) * turn
        place = tuple(back.apply(joint.position).tolist())
        axis = tuple(turn.inv().apply((0.0, 0.0, 1.0)).tolist())
        rpy = tuple(frame.as_euler("xyz").tolist())
        joints.append(replace(joint, position=place, rpy=rpy, axis=axis))
        back = turn.inv()
    *joints, flange = joints
    place = {"flange_position": flange.position, "flange_rpy": flange.rpy}
    return replace(robot, joints=tuple(joints), **place), turns.as_matrix()


def poses_in_reach(robot, n: int = 2000) -> np.ndarray:
    """Poses of the flange all over the ring that the tool can work in, `[n, 4]`."""
    rng = np.random.default_rng(0)
    distance, azimuth = rng.uniform(*robot.reach, n), rng.uniform(-1.3, 1.3, n)
    height = rng.uniform(0.16, 0.22, n) - robot.base[2]
    return np.column_stack(
        [distance * np.cos(azimuth), distance * np.sin(azimuth), height, rng.uniform(-3, 3, n)]
    )


def home(robot, n: int) -> np.ndarray:
    return np.tile(robot.home, (n, 1))


def assert_at(robot, joints, pose) -> None:
    """The flange is at a pose and points down."""
    flange = robot.link_transforms(joints)[:, -1]
    np.testing.assert_allclose(flange[:, :3, 3] - robot.base, pose[:, :3], atol=1e-8)
    np.testing.assert_allclose(flange[:, 0, 0], np.cos(pose[:, 3]), atol=1e-8)
    np.testing.assert_allclose(flange[:, 1, 0], np.sin(pose[:, 3]), atol=1e-8)
    np.testing.assert_allclose(flange[:, 2, 2], -1.0, atol=1e-8)


@pytest.mark.parametrize(("name", "tool"), [("ur5", "2f85"), ("ur5", "rod"), ("ur10", "2f85")])
def test_the_links_are_those_of_the_urdf(name, tool) -> None:
    robot = replace(ROBOTS[name], base=(0.0, 0.0, 0.0))
    chain = pytorch_kinematics.build_serial_chain_from_urdf(
        urdf_text(robot, TOOLS[tool]).encode(), end_link_name="tool"
    ).to(dtype=torch.float64)
    names = tuple(joint.name for joint in robot.joints)
    assert tuple(chain.get_joint_parameter_names()) == names
    q = (torch.rand(200, len(names), dtype=torch.float64) * 2 - 1) * math.pi
    expected = chain.forward_kinematics(q).get_matrix().numpy()
    np.testing.assert_allclose(robot.link_transforms(q.numpy())[:, -1], expected, atol=1e-7)


def test_the_zero_pose_of_the_ur5_is_the_published_one() -> None:
    # Stretched along -x: a2 + a3; sideways -(d4 + d6); height d1 - d5.
    expected = [-0.425 - 0.39225, -(0.10915 + 0.0823), 0.089159 - 0.09465]
    flange = ROBOTS["ur5"].link_transforms(np.zeros(6))[-1]
    np.testing.assert_allclose(flange[:3, 3], expected, atol=1e-12)


@pytest.mark.parametrize("name", ROBOTS)
def test_every_pose_in_reach_is_held_within_the_joints_limits(name) -> None:
    robot = ROBOTS[name]
    pose = poses_in_reach(robot)
    if name == "panda":  # its last joint cannot turn all around
        pose[:, 3] /= 2
    joints, found = robot.inverse(pose, home(robot, len(pose)))
    assert found.mean() > (0.9 if name == "panda" else 1.0 - 1e-9)
    joints, pose = joints[found], pose[found]
    assert_at(robot, joints, pose)
    low, high = robot.chain.limits.T
    assert ((joints >= low) & (joints <= high)).all()


@pytest.mark.parametrize("name", UR)
def test_damped_least_squares_find_the_closed_form_s_solution_nearby(name) -> None:
    robot = ROBOTS[name]
    pose = poses_in_reach(robot, 500)
    last, _ = robot.inverse(pose, home(robot, len(pose)))
    moved = pose + np.random.default_rng(1).uniform(-1, 1, pose.shape) * [0.02, 0.02, 0.0, 0.05]
    expected, there = robot.inverse(moved, last)
    joints, found = DampedLeastSquares(robot.chain)(moved, last)
    assert found[there].all()
    np.testing.assert_allclose(joints[there], expected[there], atol=1e-6)


@pytest.mark.parametrize("name", UR)
def test_the_working_branch_keeps_the_elbow_over_the_table(name) -> None:
    robot = ROBOTS[name]
    pose = poses_in_reach(robot)
    joints, _ = robot.inverse(pose, home(robot, len(pose)))
    elbow = robot.link_transforms(joints)[:, 3, 2, 3]
    assert elbow.min() > (0.25 if name != "ur3" else 0.2)


@pytest.mark.parametrize("name", ROBOTS)
def test_no_branch_jumps_on_long_straight_pushes(name) -> None:
    robot = ROBOTS[name]
    ends = poses_in_reach(robot, 60)
    if name == "panda":  # where no joint is at its limit
        ends = ends[np.hypot(ends[:, 0], ends[:, 1]) > 0.3]
    ends[:, 2:] = HEIGHT - robot.base[2], 0.3
    last, _ = robot.inverse(ends, home(robot, len(ends)))
    goals = np.random.default_rng(1).permutation(ends)
    for fraction in np.linspace(0, 1, 120)[1:]:
        pose = ends + (goals - ends) * fraction
        distance = np.hypot(pose[:, 0], pose[:, 1])
        least = 0.3 if name == "panda" else robot.reach[0]
        inside = (distance >= least) & (distance <= robot.reach[1])
        joints, found = robot.inverse(pose, last)
        assert found[inside].all()
        assert np.abs(joints - last)[inside].max() < 0.25
        # Ways through the middle of the ring end there.
        ends, goals, last = ends[inside], goals[inside], joints[inside]
    assert len(ends) > 15


def test_yaw_may_wind_up_to_the_last_joint_s_limit_and_no_farther() -> None:
    solve = ROBOTS["ur5"].inverse
    pose, last = np.array([[0.5, 0.0, HEIGHT, 0.0]]), np.zeros((1, 6))
    room = 2 * math.pi + solve(pose, last)[0][0, 5]  # q6 falls as yaw grows, down to -2 pi
    for beyond, expected in ((-1e-6, True), (1e-6, False)):
        turned = pose + np.array([0.0, 0.0, 0.0, room + beyond])
        assert bool(solve(turned, last)[1][0]) is expected


@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.parametrize("radius", [0.0, 1.5, 5.0])
def test_unreachable_poses_are_flagged_and_finite(name, radius: float) -> None:
    robot = ROBOTS[name]
    pose = np.array([[radius, 0.0, HEIGHT, 0.0]])
    for solve in (robot.inverse, DampedLeastSquares(robot.chain)):
        joints, found = solve(pose, home(robot, 1))
        assert not found.any()
        assert np.isfinite(joints).all()


def test_the_ur5_is_what_it_was_before_others() -> None:
    pose = np.array([*GOLDEN])
    joints, _ = ROBOTS["ur5"].inverse(pose, np.zeros((len(pose), 6)))
    np.testing.assert_allclose(joints, [*GOLDEN.values()], rtol=0, atol=1e-14)


def test_wrong_shapes_are_refused() -> None:
    solve = ROBOTS["ur5"].solve
    assert isinstance(solve, ThreeParallelAxes)
    with pytest.raises(ValueError, match=r"pose must be \[N, 4\]"):
        solve(np.zeros((1, 3)), np.zeros((1, 6)))


@pytest.mark.parametrize("name", ["panda", "ur10"])
def test_a_joint_may_turn_about_any_axis_of_its_frame(name) -> None:
    robot = ROBOTS[name]
    turned, turns = with_turned_frames(robot)
    q = np.random.default_rng(1).uniform(-1.5, 1.5, (20, len(robot.joints)))
    expected, found = robot.link_transforms(q), turned.link_transforms(q)
    np.testing.assert_allclose(found[..., :3, 3], expected[..., :3, 3], atol=1e-12)
    np.testing.assert_allclose(
        found[:, 1:-1, :3, :3], expected[:, 1:-1, :3, :3] @ turns, atol=1e-12
    )
    np.testing.assert_allclose(found[:, -1], expected[:, -1], atol=1e-12)
    pose = poses_in_reach(robot, 50)
    joints, found = replace(turned, solve=None).inverse(pose, home(robot, 50))
    assert_at(turned, joints[found], pose[found])
    assert found.mean() > 0.9


def test_the_axes_of_a_urdf_are_read_by_a_peer() -> None:
    turned, _ = with_turned_frames(ROBOTS["panda"])
    text = urdf_text(turned, TOOLS["2f85"]).encode()
    chain = pytorch_kinematics.build_serial_chain_from_urdf(text, "tool").to(dtype=torch.float64)
    q = np.random.default_rng(2).uniform(-1, 1, (10, 7))
    theirs = chain.forward_kinematics(torch.from_numpy(q)).get_matrix().numpy()
    ours = turned.link_transforms(q)[:, -1]
    ours[:, :3, 3] -= turned.base
    np.testing.assert_allclose(ours, theirs, atol=5e-6)  # the peer's axes are of single precision
