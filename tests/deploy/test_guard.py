"""Each fault stops the simulated arm, and the error says what happened."""

import ast
from dataclasses import replace as replaced
from pathlib import Path

import numpy as np
import pytest

from modpush.deploy import STOP_REASONS, Limits, Stopped
from modpush.deploy.robot_interface import RobotState
from modpush.geometry.camera_model import CameraModel
from tests.deploy.conftest import Rig, straight_push


def stopped(rig: Rig, reason: str, match: str, **options) -> None:
    """Push until the guard stops, and check why; the arm stands still afterwards."""
    with pytest.raises(Stopped, match=match) as raised:
        rig.push(**options)
    assert raised.value.reason == reason
    assert rig.stops >= 1


def after(steps: int, change, until: int = 10_000):
    """What is seen is changed from this image on, and up to another one."""
    count = 0

    def spoil(perceived):
        nonlocal count
        count += 1
        return change(perceived) if steps < count <= until else perceived

    return spoil


def moved(x=0.0, y=0.0, yaw=0.0, **fields):
    def change(perceived):
        pose = tuple(np.add(perceived.object.pose, (x, y, yaw)))
        return perceived._replace(object=perceived.object._replace(pose=pose, **fields))

    return change


def test_nothing_stops_a_push_that_is_as_it_should_be(rig) -> None:
    assert rig.push().success
    assert np.hypot(*(rig.arm.object_pose[:2] - rig.scenario.goal_position)) <= 0.05


def test_a_camera_that_looks_elsewhere(agent) -> None:
    beside = CameraModel.looking_at((0.5, 0.6, 0.0), (0.2, 0.6, 1.2), up=(1.0, 0.0, 0.0))
    stopped(
        Rig(agent, camera=beside),
        "camera",
        r"only \d+% of the workspace .* corners outside: \(0.20, -0.35\)",
    )


def test_a_camera_that_looks_away(agent) -> None:
    up = CameraModel.looking_at((0.5, 0.0, 3.0), (0.5, 0.0, 1.2), up=(1.0, 0.0, 0.0))
    stopped(Rig(agent, camera=up), "camera", r"only 0% of the workspace")


@pytest.mark.parametrize("reading", [0.0, np.nan])
def test_a_covered_camera(rig, reading) -> None:
    whole = rig.read_depth()
    rig.read_depth = lambda: whole._replace(depth=np.full_like(whole.depth, reading))
    stopped(rig, "camera", r"only 0% of the image's pixels have a depth")


def test_an_image_that_no_longer_comes(rig) -> None:
    command = rig.arm.command

    def hang(order) -> None:
        command(order)
        rig.delay += order.duration  # the camera repeats its last image

    rig.arm.command = hang
    stopped(rig, "stale_image", r"0.27 s old, allowed are 0.2 s")


def test_no_object_on_the_table(rig) -> None:
    rig.seen.change = moved(found=False)
    stopped(rig, "object_not_found", "does not show the object 'small_cube'")


def test_an_object_that_is_lost(rig) -> None:
    rig.seen.change = after(3, moved(found=False, unseen_for=31))
    stopped(rig, "object_lost", r"no image has confirmed the pose of 'small_cube' for 2.07 s")


def test_an_object_that_is_hidden_for_a_moment_is_not_lost(rig) -> None:
    rig.seen.change = after(3, moved(found=False, unseen_for=29), until=15)
    assert rig.push().success


def test_an_object_that_someone_moves(rig) -> None:
    rig.seen.change = after(3, moved(x=0.07))
    stopped(rig, "pose_jump", r"moved by (6|7|8)\d mm and \d degrees in 1 images")


def test_an_object_that_someone_turns(rig) -> None:
    # A cube looks the same after a quarter turn, so that 61 degrees are 29.
    rig.seen.change = after(3, moved(yaw=np.radians(61)))
    assert rig.push().success
    rig = Rig(rig.controller.agent, straight_push(pushed_object="fragment"))
    rig.seen.change = after(3, moved(yaw=np.radians(61)))
    stopped(rig, "pose_jump", r"6\d degrees")


@pytest.mark.parametrize(
    ("goal", "match"),
    [
        ((0.90, 0.0), r"\(0.900, 0.000\) lies outside the workspace"),
        (
            (0.75, 0.35),
            r"out of the reach of 'short', 0.83 m from its axis; it reaches 0.16 to 0.8",
        ),
    ],
)
def test_a_goal_out_of_reach(agent, goal, match) -> None:
    rig = Rig(agent)
    rig.guard._robot = replaced(rig.arm.robot, name="short", reach=(0.16, 0.8))
    stopped(rig, "goal", match, goal=goal)


def test_a_goal_behind_walls(agent) -> None:
    from modpush.envs.scenes.obstacle import Obstacle

    walls = [
        ((0.08, 0.0), (0.02, 0.2)),
        ((-0.08, 0.0), (0.02, 0.2)),
        ((0.0, 0.09), (0.14, 0.02)),
        ((0.0, -0.09), (0.14, 0.02)),
    ]
    around = tuple(
        Obstacle(pose=(0.6 + x, 0.05 + y, 0.0), size=(*size, 0.05)) for (x, y), size in walls
    )
    stopped(
        Rig(agent, straight_push(obstacles=around)), "goal", "no way leads the object to the goal"
    )


def test_a_tool_that_is_too_high(agent) -> None:
    stopped(
        Rig(agent, tip_height=0.05), "start", r"must be 0.050 m over the table, it is at 0.020 m"
    )


def test_a_tool_that_is_tilted(rig) -> None:
    observe = rig.arm.observe

    def tilted() -> RobotState:
        state = observe()
        return state._replace(joints=state.joints + np.array([0, 0, 0, 0.1, 0, 0]))

    rig.arm.observe = tilted
    stopped(rig, "start", r"straight down, it is 0.100 rad off")


def test_a_tool_that_leaves_its_workspace(agent) -> None:
    limits = Limits(high=(0.45, 0.47))
    rig = Rig(agent, limits=limits)
    stopped(rig, "workspace", r"the tip would go to \(0.4[5-9]\d, ")
    assert rig.controller.perceived.tip_pose[0] <= 0.45


def test_commands_that_are_too_fast(agent) -> None:
    stopped(Rig(agent, limits=Limits(speed=0.1)), "speed", r"asks for 0.[1-4]\d m/s")


def test_a_command_far_from_the_tip(rig) -> None:
    act = rig.controller.act

    def elsewhere(*args, **kwargs):
        command = act(*args, **kwargs)
        away = np.array([0.1, 0.0, 0.0])
        return command._replace(start=command.start + away, target=command.target + away)

    rig.controller.act = elsewhere
    stopped(rig, "speed", r"begins (9|10|11)\d? mm from the tip")


def test_commands_that_turn_back_too_suddenly(agent) -> None:
    stopped(Rig(agent, limits=Limits(acceleration=1.0)), "acceleration", r"allowed are 1.0 m/s\^2")


def test_a_joint_at_its_limit(rig) -> None:
    joints = list(rig.arm.robot.joints)
    angle = float(rig.arm.observe().joints[1])
    joints[1] = replaced(joints[1], limits=(angle - 0.01, 6.0))
    rig.guard._robot = replaced(
        rig.arm.robot, joints=tuple(joints), home=(0.2, angle, *rig.arm.robot.home[2:])
    )
    stopped(rig, "joint_limit", r"the joint 'shoulder_lift' at -\d.\d+ rad, within 0.02 rad")


def test_a_command_that_would_bring_a_joint_to_its_limit(rig) -> None:
    act = rig.controller.act

    def to_the_end(*args, **kwargs):
        command = act(*args, **kwargs)
        return command._replace(joints=np.r_[command.joints[:5], 6.28])

    rig.controller.act = to_the_end
    rig.guard.limits = Limits(joint_speed=1000.0)
    stopped(rig, "joint_limit", r"the command would bring the joint 'wrist_3' at 6.280 rad")


@pytest.mark.parametrize("call", ["observe", "command"])
def test_a_lost_connection(rig, call) -> None:
    kept, count = getattr(rig.arm, call), 0

    def fail(*args):
        nonlocal count
        count += 1
        if count > 8:
            raise ConnectionError("the cable is out.")
        return kept(*args)

    setattr(rig.arm, call, fail)
    stopped(rig, "connection", "connection: the cable is out.")


def test_a_camera_that_is_gone(rig) -> None:
    def fail():
        raise ConnectionError("no device on the bus.")

    rig.read_depth = fail
    stopped(rig, "connection", "no device on the bus")


def test_an_arm_that_cannot_be_told_to_stop(rig) -> None:
    def fail(*_) -> None:
        raise ConnectionError("no route to host.")

    rig.arm.stop = rig.arm.command = fail
    with pytest.raises(Stopped, match="could not be told to stop: no route to host"):
        rig.push()


def test_ctrl_c_stops_the_arm(rig) -> None:
    def interrupt(image, command) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        rig.push(on_step=interrupt)
    assert rig.stops == 1


def test_every_reason_is_provoked() -> None:
    """By the calls in this file, since its tests may run in several processes."""
    nodes = list(ast.walk(ast.parse(Path(__file__).read_text())))
    calls = [n for n in nodes if isinstance(n, ast.Call) and getattr(n.func, "id", "") == "stopped"]
    assert {ast.literal_eval(call.args[1]) for call in calls} == set(STOP_REASONS)
