"""`URRobot` against a scripted peer; it has never run on hardware."""

import importlib.util
import math
import sys
import time

import numpy as np
import pytest

from modpush._extras import MissingExtraError
from modpush.deploy import Command, URRobot
from modpush.deploy.ur_robot import tool_down_pose
from modpush.envs.robot.control import start_joints
from modpush.envs.robot.named import find_robot, find_tool
from tests.deploy.ur_peer import Peer, install

START = (0.45, 0.05, 0.3)
HEIGHT = 0.02


@pytest.fixture
def peer(monkeypatch) -> Peer:
    joints = start_joints(find_robot("ur5"), find_tool("2f85"), START, HEIGHT)
    made = Peer(joints)
    install(monkeypatch, made)
    return made


@pytest.fixture
def arm(peer):
    made = URRobot("192.0.2.1")
    made.connect()
    yield made
    made.close()


def command(start=START, step=(0.02, 0.0, 0.05), duration=1 / 15) -> Command:
    start = np.array(start)
    return Command(start, start + step, HEIGHT, np.zeros(6), duration, True)


def test_without_the_package_it_says_what_to_install(monkeypatch) -> None:
    if importlib.util.find_spec("rtde_control") is not None:
        pytest.skip("ur_rtde is installed")
    with pytest.raises(MissingExtraError, match=r"modpush\[ur\]"):
        URRobot("192.0.2.1")


def test_the_peer_has_names_of_the_package_alone(monkeypatch) -> None:
    """Compared where `ur_rtde` is installed."""
    names = {"rtde_control": "RTDEControlInterface", "rtde_receive": "RTDEReceiveInterface"}
    theirs = {name: dir(getattr(pytest.importorskip(name), cls)) for name, cls in names.items()}
    install(monkeypatch, Peer(np.zeros(6)))
    for name, cls in names.items():
        ours = [one for one in vars(getattr(sys.modules[name], cls)) if not one.startswith("_")]
        assert set(ours) <= set(theirs[name])


def test_it_reports_joints_and_time(arm, peer) -> None:
    state = arm.observe()
    assert state.joints == pytest.approx(peer.joints)
    assert state.stamp == pytest.approx(time.monotonic(), abs=1.0)


def test_a_command_becomes_a_straight_way_at_constant_speed(arm, peer) -> None:
    begin = time.monotonic()
    arm.command(command(duration=0.4))
    assert time.monotonic() - begin == pytest.approx(0.4, abs=0.15)
    stamps, poses = zip(*peer.sent, strict=True)
    poses = np.array(poses)
    assert len(poses) >= 5
    share = (poses[:, 0] - START[0]) / 0.02
    assert (np.diff(share) >= 0).all()
    assert share.max() <= 1.0 + 1e-9
    expected = (np.array(stamps) - begin) / 0.4
    assert share == pytest.approx(expected.clip(0, 1), abs=0.2)
    assert poses[:, 2] == pytest.approx(HEIGHT)
    yaw = 2 * np.arctan2(poses[:, 4], poses[:, 3])
    assert yaw == pytest.approx(START[2] + 0.05 * share, abs=1e-6)


def test_the_next_command_continues_where_the_last_one_ended(arm, peer) -> None:
    arm.command(command())
    arm.command(command(start=(0.455, 0.05, 0.3)))  # the tip lags by 15 mm
    poses = np.array([pose for _, pose in peer.sent])
    assert (np.diff(poses[:, 0]) >= -1e-9).all()  # no jump back


def test_without_a_further_command_it_stays_at_the_target(arm, peer) -> None:
    arm.command(command())
    time.sleep(0.15)
    assert peer.pose[0] == pytest.approx(START[0] + 0.02)


def test_steps_begin_at_a_fixed_rate(arm, peer) -> None:
    begin = time.monotonic()
    x = START[0]
    for _ in range(5):
        time.sleep(0.03)  # images and policy
        arm.command(command(start=(x, *START[1:]), duration=0.1))
        x += 0.02
    # Five steps of 0.1 s after the first 0.03 s, and not five of 0.13 s.
    assert time.monotonic() - begin < 0.60


def test_stopping_ends_the_poses(arm, peer) -> None:
    arm.command(command())
    arm.stop()
    assert peer.log[-1] == "servoStop"
    count = len(peer.sent)
    time.sleep(0.05)
    assert len(peer.sent) == count


def test_after_a_stop_it_begins_where_the_tip_is(arm, peer) -> None:
    arm.command(command())
    arm.stop()
    peer.sent.clear()
    arm.command(command(start=(0.40, 0.05, 0.3)))
    assert peer.sent[0][1][0] == pytest.approx(0.40, abs=0.02)
    assert peer.sent[0][1][0] < 0.425


def test_closing_stops_and_disconnects_once(peer) -> None:
    arm = URRobot("192.0.2.1")
    arm.connect()
    arm.close()
    arm.close()
    assert peer.log[-4:] == [
        "servoStop",
        "stopScript",
        "control disconnected",
        "receive disconnected",
    ]
    with pytest.raises(ConnectionError, match="not connected"):
        arm.observe()


@pytest.mark.parametrize(
    ("fault", "match"),
    [
        ({"connected": False}, "the connection to 192.0.2.1 is lost"),
        ({"protective": True}, "protective stop"),
        ({"emergency": True}, "the emergency stop is pressed"),
    ],
)
def test_what_is_wrong_with_the_arm_is_said(arm, peer, fault, match) -> None:
    vars(peer).update(fault)
    for call in (arm.observe, lambda: arm.command(command())):
        with pytest.raises(ConnectionError, match=match):
            call()


def test_a_refused_pose_is_told_by_the_next_call(arm, peer) -> None:
    peer.refuse_after = 2
    with pytest.raises(ConnectionError, match=r"servoL failed: the controller refused a pose"):
        arm.command(command(duration=0.3))


def test_no_controller_at_the_address(peer) -> None:
    peer.reachable = False
    with pytest.raises(ConnectionError, match=r"no connection to 192\.0\.2\.1: Connection refused"):
        URRobot("192.0.2.1").connect()


def test_another_tool_centre_point_is_refused(peer) -> None:
    peer.pose[2] += 0.163  # that of the flange
    with pytest.raises(
        ConnectionError, match=r"it is 163\.0 mm away; set the TCP to \(0, 0, 0\.163\)"
    ):
        URRobot("192.0.2.1").connect()
    assert "control disconnected" in peer.log


@pytest.mark.parametrize("yaw", [0.0, 0.7, -2.0, 3.5])
def test_the_pose_s_turn_points_the_tool_down(yaw) -> None:
    import cv2

    pose = tool_down_pose(np.array([0.4, 0.1, 0.02]), yaw)
    turn, _ = cv2.Rodrigues(np.array(pose[3:]))
    assert turn[:, 2] == pytest.approx([0, 0, -1], abs=1e-9)
    assert turn[:, 0] == pytest.approx([math.cos(yaw), math.sin(yaw), 0], abs=1e-9)
