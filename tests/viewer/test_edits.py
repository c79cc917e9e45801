"""Changes of a scene, by hand-computed numbers."""

import math

import pytest

from modpush.envs import Obstacle, Scenario
from modpush.envs.robot.named import ROBOTS, TOOLS
from modpush.viewer import edits

UR5 = ROBOTS["ur5"]
ARM = (UR5, TOOLS["2f85"])
CUBE = Obstacle((0.05, 0.05, 0.05), (0.5, 0.0, 0.3))
SCENE = Scenario(
    scene="free",
    difficulty=0.0,
    obstacles=(CUBE,),
    pushed_object="small_cube",
    object_pose=(0.4, 0.2, 0.1),
    goal_position=(0.4, -0.2),
    tool_pose=(0.3, 0.2, 0.0),
)


def test_a_goal_beyond_the_workspace_lands_on_its_edge() -> None:
    assert edits.move_goal(SCENE, 0.5, 2.0).goal_position == (0.5, 0.35)


def test_a_goal_beyond_reach_is_pulled_in_along_its_line() -> None:
    x, y = edits.move_goal(SCENE, 0.75, 0.35).goal_position  # 0.828 m from the robot's axis
    assert math.hypot(x, y) == pytest.approx(0.82)
    assert y / x == pytest.approx(0.35 / 0.75)


def test_an_obstacle_keeps_its_yaw_when_moved_and_its_place_when_turned() -> None:
    moved = edits.move_obstacle(SCENE, 0, 0.6, 0.1)
    assert moved.obstacles[0].pose == (0.6, 0.1, 0.3)
    assert edits.move_obstacle(moved, 0, 0.6, 0.1, 1.0).obstacles[0].pose == (0.6, 0.1, 1.0)


def test_a_scene_that_cannot_continue_is_refused() -> None:
    free, far = (0.4, 0.2, 0.0), (0.3, 0.2, 0.0)
    edits.check_scene(SCENE, free, far, *ARM)
    with pytest.raises(ValueError, match="where the object is"):
        edits.check_scene(SCENE, (0.5, 0.05, 0.0), far, *ARM)
    with pytest.raises(ValueError, match="where the tool is"):
        edits.check_scene(SCENE, free, (0.5, 0.05, 0.0), *ARM)
    with pytest.raises(ValueError, match="at the goal"):
        edits.check_scene(SCENE, (0.4, -0.16, 0.0), far, *ARM)
    with pytest.raises(ValueError, match="out of bounds"):
        edits.check_scene(SCENE, (0.4, 0.41, 0.0), far, *ARM)


def test_an_obstacle_is_refused_where_the_arm_s_shoulder_turns() -> None:
    moved = edits.move_obstacle(SCENE, 0, 0.21, -0.03)
    with pytest.raises(
        ValueError, match=r"cannot stand there: expected obstacles .* at least 0.200 m"
    ):
        edits.check_scene(moved, moved.object_pose, moved.tool_pose, *ARM)
