"""Changes of a running scene, as functions from one scenario to another."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from modpush.envs.outcome import is_at_goal, is_out_of_bounds
from modpush.envs.robot.robot import Robot, Tool
from modpush.envs.scenes.arm_room import check_arm_is_free
from modpush.envs.scenes.objects import get_object
from modpush.envs.scenes.obstacle import Obstacle
from modpush.envs.scenes.rectangles import obstacle_distance
from modpush.envs.scenes.scenario import Scenario, ScenarioConfig
from modpush.geometry.workspace import WORKSPACE


def continue_from(
    scenario: Scenario, object_pose: Sequence[float], tool_pose: Sequence[float]
) -> Scenario:
    """The same scene, starting from where object and tool are now."""
    x, y, yaw = object_pose
    tool_x, tool_y, tool_yaw = tool_pose
    return replace(scenario, object_pose=(x, y, yaw), tool_pose=(tool_x, tool_y, tool_yaw))


def move_goal(scenario: Scenario, x: float, y: float, yaw: float | None = None) -> Scenario:
    """The goal put elsewhere, at the nearest place in the workspace and within reach.

    `x`, `y` [m]; the yaw [rad] stays as it was where none is given.

    Raises:
        ValueError: If a yaw is given and the goal is a position.
    """
    if yaw is not None and scenario.goal_yaw is None:
        raise ValueError("The goal is a position, which has no yaw: play with goal='pose'.")
    (x0, y0), (x1, y1) = WORKSPACE
    x, y = min(max(x, x0), x1), min(max(y, y0), y1)
    shrink = min(1.0, ScenarioConfig().max_goal_radius / math.hypot(x, y))
    turned = scenario.goal_yaw if yaw is None else yaw
    return replace(scenario, goal_position=(x * shrink, y * shrink), goal_yaw=turned)


def move_obstacle(
    scenario: Scenario, index: int, x: float, y: float, yaw: float | None = None
) -> Scenario:
    """An obstacle put elsewhere, with its centre on the table in front of the robot.

    `x`, `y` [m]; the yaw of its long axis [rad] stays as it was where none is given.

    Raises:
        ValueError: If there is no such obstacle.
    """
    obstacles = list(scenario.obstacles)
    if not 0 <= index < len(obstacles):
        raise ValueError(
            f"There is no obstacle with index {index}, this scene has {len(obstacles)}."
        )
    old = obstacles[index]
    (x0, y0), (x1, y1) = WORKSPACE.bounds(0.1)
    pose = (min(max(x, x0), x1), min(max(y, y0), y1), old.pose[2] if yaw is None else yaw)
    obstacles[index] = _with_patrol(old, pose)
    return replace(scenario, obstacles=tuple(obstacles))


def _with_patrol(old: Obstacle, pose: tuple[float, float, float]) -> Obstacle:
    """An obstacle at another pose. One that moves stays between its ends, and its line moves sideways."""
    motion = old.motion
    if motion is None:
        return Obstacle(old.size, pose)
    direction = np.array(motion.velocity) / math.hypot(*motion.velocity)
    way = np.array(pose[:2]) - old.pose[:2]
    along = float(np.clip(way @ direction, -motion.behind, motion.ahead))
    x, y = np.array(pose[:2]) + (along - way @ direction) * direction
    patrol = replace(motion, ahead=motion.ahead - along, behind=motion.behind + along)
    return Obstacle(old.size, (float(x), float(y), pose[2]), patrol)


def check_scene(
    scenario: Scenario,
    object_pose: Sequence[float],
    tool_pose: Sequence[float],
    robot: Robot,
    tool: Tool,
) -> None:
    """Refuse a scene in which no episode can continue, with object and tool at poses [m, m, rad].

    Raises:
        ValueError: If an obstacle stands where object or tool are or where the arm's shoulder turns, or
            the object is at a goal position or out of bounds.
    """
    position = np.array([object_pose[:2]])
    if is_out_of_bounds(position, WORKSPACE.bounds())[0]:
        raise ValueError("The object is out of bounds: begin another episode.")
    # At the place of a goal pose the object may still have to be turned: the reset checks that.
    at_goal = is_at_goal(position, np.array([scenario.goal_position]))[0]
    if at_goal and scenario.goal_yaw is None:
        raise ValueError("The object is at the goal: move the goal away from it.")
    item = get_object(scenario.pushed_object)
    points = np.array([object_pose[:2], tool_pose[:2]])
    distance = obstacle_distance(points, scenario.obstacles)
    for what, gap, least in zip(
        ("object", "tool"), distance, (item.radius, math.hypot(*tool.tip_half_extents)), strict=True
    ):
        if gap < least:
            raise ValueError(f"An obstacle cannot stand where the {what} is.")
    check_arm_is_free("An obstacle cannot stand there", scenario, item.tool_height, tool, robot)
