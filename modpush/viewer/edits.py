"""Changes of a running scene, as functions from one scenario to another."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from modpush._validation import check_value
from modpush.envs.outcome import is_at_goal, is_out_of_bounds
from modpush.envs.robot.robot import Robot, Tool
from modpush.envs.scenes.arm_room import arm_reach, check_arm_is_free
from modpush.envs.scenes.layouts import BAR_SECTION, CUBE_SIDE
from modpush.envs.scenes.objects import get_object
from modpush.envs.scenes.obstacle import MAX_OBSTACLES, Obstacle
from modpush.envs.scenes.rectangles import obstacle_distance
from modpush.envs.scenes.scenario import Scenario, ScenarioConfig
from modpush.geometry.workspace import WORKSPACE

ObstacleKind = Literal["cube", "bar"]
OBSTACLE_SIZES: dict[ObstacleKind, tuple[float, float, float]] = {
    "cube": (CUBE_SIDE, CUBE_SIDE, CUBE_SIDE),
    "bar": (0.20, BAR_SECTION, BAR_SECTION),
}
"""Length, width and height of the obstacles that can be added [m]."""

_NEW_CLEARANCE = 0.04  # around a new obstacle [m]


def continue_from(
    scenario: Scenario, object_pose: Sequence[float], tool_pose: Sequence[float]
) -> Scenario:
    """The same scene, starting from where object and tool are now."""
    x, y, yaw = object_pose
    tool_x, tool_y, tool_yaw = tool_pose
    return replace(scenario, object_pose=(x, y, yaw), tool_pose=(tool_x, tool_y, tool_yaw))


def move_goal(scenario: Scenario, x: float, y: float, yaw: float | None = None) -> Scenario:
    """The goal put elsewhere, at the nearest place in the workspace and within reach.

    Args:
        scenario: The scene.
        x: Position [m].
        y: Position [m].
        yaw: Yaw of a goal pose [rad]; as it was if not given.

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

    Args:
        scenario: The scene.
        index: Index of the obstacle.
        x: Position [m].
        y: Position [m].
        yaw: Direction of its long axis [rad]; as it was if not given.

    Raises:
        ValueError: If there is no such obstacle.
    """
    old = _get(scenario, index)
    (x0, y0), (x1, y1) = WORKSPACE.bounds(0.1)
    pose = (min(max(x, x0), x1), min(max(y, y0), y1), old.pose[2] if yaw is None else yaw)
    obstacles = list(scenario.obstacles)
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


def remove_obstacle(scenario: Scenario, index: int) -> Scenario:
    """The scene without one of its obstacles.

    Raises:
        ValueError: If there is no such obstacle.
    """
    _get(scenario, index)
    kept = [o for i, o in enumerate(scenario.obstacles) if i != index]
    return replace(scenario, obstacles=tuple(kept))


def _get(scenario: Scenario, index: int) -> Obstacle:
    if not 0 <= index < len(scenario.obstacles):
        raise ValueError(
            f"There is no obstacle with index {index}, this scene has {len(scenario.obstacles)}."
        )
    return scenario.obstacles[index]


def add_obstacle(
    scenario: Scenario,
    kind: ObstacleKind,
    keep_free: Sequence[tuple[Sequence[float], float]],
    robot: Robot,
) -> Scenario:
    """One more obstacle, at the free place nearest to the middle of the way to the goal.

    Args:
        scenario: The scene; its object pose and goal say where the way is.
        kind: Kind of the obstacle.
        keep_free: Further circles that it must not touch, centre (x, y) and radius [m].
        robot: The arm, which needs room around its base.

    Raises:
        ValueError: If there is no such kind, or the scene is full.
    """
    check_value("kind", kind, ObstacleKind)
    if len(scenario.obstacles) >= MAX_OBSTACLES:
        raise ValueError(f"A scene holds at most {MAX_OBSTACLES} obstacles.")
    size = OBSTACLE_SIZES[kind]
    across = math.pi / 2  # the long axis of a bar lies across the way out from the robot
    (x0, y0), (x1, y1) = WORKSPACE
    grid = np.stack(np.meshgrid(np.arange(x0, x1, 0.02), np.arange(y0, y1, 0.02)), -1)
    places = grid.reshape(-1, 2)
    object_radius = get_object(scenario.pushed_object).radius
    circles = [
        (scenario.object_pose[:2], object_radius),
        (scenario.goal_position, object_radius),
        (robot.base[:2], arm_reach(robot, size[2]) - _NEW_CLEARANCE),
        *keep_free,
    ]
    centers = np.array([center[:2] for center, _ in circles])
    radii = np.array([radius for _, radius in circles])
    new = Obstacle(size, (0.0, 0.0, across))
    free = np.ones(len(places), dtype=bool)
    for center, radius in zip(centers, radii, strict=True):
        free &= obstacle_distance(center - places, [new]) > radius + _NEW_CLEARANCE
    reach = math.hypot(*size[:2]) / 2
    free &= obstacle_distance(places, scenario.obstacles) > reach
    if not free.any():
        raise ValueError("There is no free place for another obstacle.")
    middle = centers[:2].mean(0)
    x, y = _nearest(places[free], middle)
    return replace(scenario, obstacles=(*scenario.obstacles, Obstacle(size, (x, y, across))))


def _nearest(places: NDArray[np.float64], wanted: NDArray[np.float64]) -> tuple[float, float]:
    x, y = places[np.argmin(np.linalg.norm(places - wanted, axis=-1))].tolist()
    return x, y


def check_scene(
    scenario: Scenario,
    object_pose: Sequence[float],
    tool_pose: Sequence[float],
    robot: Robot,
    tool: Tool,
) -> None:
    """Refuse a scene in which no episode can continue.

    Args:
        scenario: The scene after a change.
        object_pose: Pose of the object [m, m, rad].
        tool_pose: Pose of the tool's tip [m, m, rad].
        robot: The arm.
        tool: Its tool.

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
