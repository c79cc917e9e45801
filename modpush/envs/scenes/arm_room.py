"""Starts that an arm can take: within its reach, with no obstacle in its links or its tool."""

import functools
import math
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from modpush._checks import check_instance
from modpush.envs.robot.control import MotionConfig, OutOfReachError, start_joints
from modpush.envs.robot.named import find_robot, find_tool
from modpush.envs.robot.robot import Robot, Tool
from modpush.envs.robot.urdf import extent
from modpush.envs.scenes.objects import get_object
from modpush.envs.scenes.obstacle import Obstacle
from modpush.envs.scenes.rectangles import (
    nearest_rectangle,
    rectangles,
    rectangles_touch,
    turned_rectangles,
)
from modpush.envs.scenes.scenario import Scenario
from modpush.geometry.shapes import Primitive

MAX_HEIGHT = 0.15
"""Height of the tallest obstacles [m]. With a shipped arm and tool, forearm and wrist stay above it."""
_FLANGE_HEIGHT = 0.175  # with a shipped tool and its tip as low as it gets [m]
_TOOL_LENGTH = 0.16  # of the shortest shipped tool; the flange of a shorter one is lower [m]
_HEIGHT_ERROR = 0.002  # allowed for the height at which an arm holds its tool [m]
_SAFETY_MARGIN = 0.01  # added to what was measured at some poses of the tool [m]
_STEP = 0.005  # between the places at which a moving obstacle is looked at [m]


def keep_out_radius(robot: Robot, tool: Tool, height: float) -> float:
    """Distance that obstacles of a height keep from the robot's axis [m].

    Nearer to it links come down to that height at some pose of the tool in its workspace
    (`MotionConfig`). An upper bound, up to `MAX_HEIGHT`.
    """
    lower = max(0.0, _TOOL_LENGTH - tool.length)
    given = None if robot.room is None else robot.room.distance(height)
    if given is not None and lower == 0:
        return given
    heights, distances = _measured_room(robot, _FLANGE_HEIGHT - lower)
    return max(float(np.interp(height, heights, distances)), given or 0.0)


@functools.lru_cache(maxsize=64)
def _measured_room(
    robot: Robot, flange_height: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Heights `[n]`, and how far ahead the links come down to each of them, `[n]` [m].

    The links are those of the poses of a grid over the tool's workspace.
    """
    motion, base = MotionConfig(), np.array(robot.base)
    sides = (np.linspace(motion.low[i], motion.high[i], 17) - base[i] for i in (0, 1))
    places = np.stack(np.meshgrid(*sides), -1).reshape(-1, 2)
    radius = np.linalg.norm(places, axis=1)
    places = places[(radius >= robot.reach[0]) & (radius <= robot.reach[1])]
    n = len(places)
    pose = np.column_stack([places, np.full(n, flange_height - base[2]), np.zeros(n)])
    joints, found = robot.inverse(pose, np.tile(robot.home, (n, 1)))
    transforms = robot.link_transforms(joints[found])[:, :-1]
    points = [
        _surface(shape) @ transforms[:, i, :3, :3].swapaxes(-1, -2) + transforms[:, i, None, :3, 3]
        for i, link in enumerate(robot.links)
        for shape in link.shapes
    ]
    x, y, z = np.concatenate([one.reshape(-1, 3) for one in points]).T
    ahead = x >= base[0]
    distance, z = np.hypot(x - base[0], y - base[1])[ahead], z[ahead]
    heights = np.linspace(0.0, MAX_HEIGHT, 16)
    room = [
        distance[z <= height + _SAFETY_MARGIN].max(initial=0.0) + _SAFETY_MARGIN
        for height in heights
    ]
    return heights, np.array(room)


def _surface(shape: Primitive) -> NDArray[np.float64]:
    """Points on the surface of a solid in its link's frame, `[n, 3]` [m]."""
    a, b, c = shape.size
    if shape.kind == "box":
        grid = np.stack(np.meshgrid(*[np.linspace(-1, 1, 5)] * 3), -1).reshape(-1, 3)
        points = grid[(np.abs(grid) == 1).any(-1)] * (a, b, c)
    else:
        angle, up = np.meshgrid(np.linspace(0, 2 * np.pi, 17), np.linspace(-1, 1, 17))
        along = up * (b + a * (shape.kind == "capsule"))
        beyond = np.maximum(np.abs(along) - b, 0.0)
        across = np.sqrt(np.maximum(a**2 - beyond**2, 0.0))
        points = np.stack([across * np.cos(angle), across * np.sin(angle), along], -1)
    return points.reshape(-1, 3) @ shape.rotation().T + shape.position


def obstacle_near_arm(obstacles: Sequence[Obstacle], robot: Robot, tool: Tool) -> str | None:
    """The first obstacle that stands where the arm's links turn, in words; None if none does.

    One that moves is looked at wherever it comes.
    """
    base_x, base_y, _ = robot.base
    turned = turned_rectangles(rectangles(obstacles))
    for k, obstacle in enumerate(obstacles):
        height, (x, y, _) = obstacle.size[2], obstacle.pose
        distance = nearest_rectangle(base_x, base_y, turned[k : k + 1])
        if obstacle.motion is not None:
            distance = nearest_rectangle(base_x, base_y, turned_rectangles(_places(obstacle)))
        if height > MAX_HEIGHT:
            return (
                f"expected heights up to {MAX_HEIGHT} m, over which the arm passes, got {height:g}"
            )
        if distance < (least := keep_out_radius(robot, tool, height)):
            return (
                f"expected obstacles {height:g} m high at least {least:.3f} m from the "
                f"robot's axis, within which its links come down to them, got {distance:.3f} m for "
                f"the one at ({x:.3f}, {y:.3f})"
            )
    return None


def _places(obstacle: Obstacle) -> np.ndarray:
    """Footprints, as `rectangles` gives them, of an obstacle at places 5 mm apart on its patrol."""
    start, end = obstacle.ends()
    count = math.ceil(np.linalg.norm(end - start) / _STEP) + 1
    rows = np.repeat(rectangles([obstacle]), count, axis=0)
    rows[:, :2] = np.linspace(start, end, count)
    return rows


def tool_touches(
    pose: Sequence[float],
    tip_height: float,
    obstacles: Sequence[Obstacle],
    tool: Tool,
    gap: float = 0.0,
) -> bool:
    """True if a part of the tool is in an obstacle, or nearer to one than a gap [m].

    Its tip is at a pose (x, y, yaw) [m, m, rad] and a height over the table [m].
    """
    x, y, yaw = pose
    rows = rectangles(obstacles)
    heights = np.array([obstacle.size[2] for obstacle in obstacles])
    for shape in tool.shapes:
        length, width, _ = extent(shape)
        tall = rows[heights + gap > _bottom(shape, tool, tip_height)]
        # The tool's y axis is turned over, since its z axis points down.
        aside, ahead = shape.position[0], -shape.position[1]
        center_x = x + aside * math.cos(yaw) - ahead * math.sin(yaw)
        center_y = y + aside * math.sin(yaw) + ahead * math.cos(yaw)
        row = np.array([center_x, center_y, yaw, length, width])
        if len(tall) and rectangles_touch(row, tall, gap):
            return True
    return False


def tool_half_extents(tool: Tool, tip_height: float, height: float) -> NDArray[np.float64]:
    """Half of the sides, along its x and y, of a tool's parts that are lower than a height, `[2]` [m].

    Parts less than 2 mm above it count, and so does the tip, which is at `tip_height`, all over the table
    [m].
    """
    found = np.array(tool.tip_half_extents)
    for shape in tool.shapes:
        if _bottom(shape, tool, tip_height) < height + _HEIGHT_ERROR:
            sides, place = np.array(extent(shape)), np.array(shape.position)
            found = np.maximum(found, np.abs(place[:2]) + sides[:2] / 2)
    return found


def _bottom(shape: Primitive, tool: Tool, tip_height: float) -> float:
    """Height over the table of the lowest point of a part of a tool, whose tip is at `tip_height` [m]."""
    return tip_height + tool.length - shape.position[2] - extent(shape)[2] / 2


def check_arm_is_free(
    name: str, scenario: Scenario, tip_height: float, tool: Tool, robot: Robot
) -> None:
    """Refuse a start at which the arm stands in an obstacle, or turns into one near its shoulder.

    `tip_height` is `PushedObject.tool_height` [m]; `name` begins the ValueError.
    """
    if (why := obstacle_near_arm(scenario.obstacles, robot, tool)) is not None:
        raise ValueError(f"{name}: {why}.")
    if tool_touches(scenario.tool_pose, tip_height, scenario.obstacles, tool):
        x, y, yaw = scenario.tool_pose
        raise ValueError(
            f"{name}: expected a tool that stands free, got one in an obstacle, at ({x:.3f}, {y:.3f}), "
            f"turned by {math.degrees(yaw):.0f} degrees."
        )


def within_reach(
    scenarios: Iterable[Scenario], robot: str | Robot = "ur5", tool: str | Tool = "2f85"
) -> list[Scenario]:
    """The scenarios that an arm can begin, in their order.

    The arm holds its tool at the start's pose there, and neither tool nor links stand in an obstacle. It
    says nothing of the way to the goal.

    Args:
        scenarios: Starts of episodes, an `EvaluationSet` for instance.
        robot: The arm: by name, as `"module:name"`, or as an object.
        tool: Its tool, in the same three ways.

    Raises:
        TypeError: If something else is among the scenarios.
        ValueError: If there is no such robot or tool, or the robot's `solve` returns something else than
            an `InverseKinematics`.
    """
    robot, tool, kept = find_robot(robot), find_tool(tool), []
    for scenario in scenarios:
        check_instance("scenarios", scenario, Scenario)
        height = get_object(scenario.pushed_object).tool_height
        try:  # any other error is a fault of the robot
            start_joints(robot, tool, scenario.tool_pose, height)
        except OutOfReachError:
            continue
        blocked = obstacle_near_arm(scenario.obstacles, robot, tool) is not None
        if not (blocked or tool_touches(scenario.tool_pose, height, scenario.obstacles, tool)):
            kept.append(scenario)
    return kept
