"""Obstacles in the arm: in the region of shoulder and upper arm, or in the tool at a start."""

import math
from collections.abc import Sequence

import numpy as np

from modpush.envs.robot.ur5_2f85 import TOOLS, ToolName
from modpush.envs.scenes.obstacle import Obstacle
from modpush.envs.scenes.rectangles import (
    nearest_rectangle,
    rectangles,
    rectangles_touch,
    turned_rectangles,
)
from modpush.envs.scenes.scenario import Scenario

__all__ = ["MAX_HEIGHT", "arm_reach", "check_arm_is_free", "obstacle_in_arm", "tool_touches"]

MAX_HEIGHT = 0.15
"""Height of the tallest obstacles [m]. Forearm and wrist stay above it wherever the tool is."""

_STEP = 0.005  # between the places at which a moving obstacle is looked at [m]


def arm_reach(height: float) -> float:
    """Distance from the robot's axis up to which shoulder or upper arm come down to a height [m].

    For some pose of the tool in its workspace (`MotionConfig`). The shoulder turns within 0.2 m; of the
    inclined upper arm more comes down to greater heights. An upper bound, up to `MAX_HEIGHT`.

    Args:
        height: Height over the table [m].
    """
    return 0.20 + 1.75 * max(0.0, height - 0.08)


def obstacle_in_arm(obstacles: Sequence[Obstacle]) -> str | None:
    """The first obstacle that stands where shoulder or upper arm turn, in words; None if none does.

    One that moves is looked at wherever it comes.
    """
    turned = turned_rectangles(rectangles(obstacles))
    for k, obstacle in enumerate(obstacles):
        height, (x, y, _) = obstacle.size[2], obstacle.pose
        distance = nearest_rectangle(0.0, 0.0, turned[k : k + 1])
        if obstacle.motion is not None:
            distance = nearest_rectangle(0.0, 0.0, turned_rectangles(_places(obstacle)))
        if height > MAX_HEIGHT:
            return (
                f"expected heights up to {MAX_HEIGHT} m, over which the arm passes, got {height:g}"
            )
        if distance < arm_reach(height):
            return (
                f"expected obstacles {height:g} m high at least {arm_reach(height):.3f} m from the "
                f"robot's axis, within which its shoulder and upper arm turn, got {distance:.3f} m for "
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
    tool: ToolName,
    gap: float = 0.0,
) -> bool:
    """True if a part of the tool is in an obstacle, or nearer to one than a gap.

    Args:
        pose: x, y, yaw of the tool's tip [m, m, rad].
        tip_height: Height of the tip over the table [m].
        obstacles: The obstacles.
        tool: Name of the tool.
        gap: Least distance [m].
    """
    x, y, yaw = pose
    rows = rectangles(obstacles)
    heights = np.array([obstacle.size[2] for obstacle in obstacles])
    for shape in TOOLS[tool].shapes:  # boxes upright on the tool's axis
        half_length, half_width, half_height = shape.size
        bottom = tip_height + TOOLS[tool].length - shape.position[2] - half_height
        tall = rows[heights + gap > bottom]
        row = np.array([x, y, yaw, 2 * half_length, 2 * half_width])
        if len(tall) and rectangles_touch(row, tall, gap):
            return True
    return False


def check_arm_is_free(name: str, scenario: Scenario, tip_height: float, tool: ToolName) -> None:
    """Refuse a start at which the arm stands in an obstacle, or turns into one near its shoulder.

    Args:
        name: Begins the error.
        scenario: The start.
        tip_height: Height of the tip over the table, `PushedObject.tool_height` [m].
        tool: Name of the tool.

    Raises:
        ValueError: If it does.
    """
    if (why := obstacle_in_arm(scenario.obstacles)) is not None:
        raise ValueError(f"{name}: {why}.")
    if tool_touches(scenario.tool_pose, tip_height, scenario.obstacles, tool):
        x, y, yaw = scenario.tool_pose
        raise ValueError(
            f"{name}: expected a tool that stands free, got one in an obstacle, at ({x:.3f}, {y:.3f}), "
            f"turned by {math.degrees(yaw):.0f} degrees."
        )
