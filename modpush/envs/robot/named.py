"""The robots and tools by name."""

from typing import Any

from modpush.envs.robot.panda import PANDA
from modpush.envs.robot.robot import Robot, Tool
from modpush.envs.robot.universal_robots import UR_ROBOTS
from modpush.geometry.shapes import box
from modpush.parts import check_part, find_part

ROBOTS: dict[str, Robot] = {**UR_ROBOTS, PANDA.name: PANDA}
"""The robots that the library brings, by name."""

_GREY, _DARK = (0.72, 0.74, 0.76), (0.25, 0.26, 0.28)

TOOLS: dict[str, Tool] = {
    # Closed by construction: one rigid link. The linkage juts out beyond the fingers along x.
    "2f85": Tool(
        name="2f85",
        mass=0.9,
        length=0.163,
        tip_half_extents=(0.032, 0.011),
        shapes=(
            box(0.084, 0.076, 0.090, (0.0, 0.0, 0.045), color=_DARK),
            box(0.124, 0.027, 0.071, (0.0, 0.0, 0.0825), color=_DARK),
            box(0.064, 0.022, 0.057, (0.0, 0.0, 0.1345), color=_GREY),
        ),
        half_turn=True,
    ),
    "rod": Tool(
        name="rod",
        mass=0.2,
        length=0.16,
        tip_half_extents=(0.01, 0.01),
        shapes=(box(0.02, 0.02, 0.16, (0.0, 0.0, 0.08), color=_DARK),),
        half_turn=True,
    ),
}
"""The tools by name. The paper names the gripper, whose sizes are as measured on a 2F-85; the authors'
released code pushes with the rod."""


def find_robot(robot: str | Robot) -> Robot:
    """A robot by name, by `"module:name"`, or passed through.

    Raises:
        ValueError: If there is no such robot (the known ones are listed), or it is no `Robot`.
    """
    found: Robot = find_part("robot", robot, ROBOTS, Robot)
    return found


def find_tool(tool: str | Tool) -> Tool:
    """A tool, as `find_robot` finds a robot."""
    found: Tool = find_part("tool", tool, TOOLS, Tool)
    return found


def check_robot(who: str, robot: Any) -> None:
    """Refuse what cannot be a robot, without importing anything; `who` has it, for the error."""
    check_part(f"{who}: robot", robot, ROBOTS, Robot)


def check_tool(who: str, tool: Any) -> None:
    """Refuse what cannot be a tool, without importing anything."""
    check_part(f"{who}: tool", tool, TOOLS, Tool)
