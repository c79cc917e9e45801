"""The robots and tools by name."""

from typing import Any

from modpush.envs.robot.panda import PANDA
from modpush.envs.robot.robot import Robot, Tool
from modpush.envs.robot.tools import TOOLS
from modpush.envs.robot.universal_robots import UR_ROBOTS
from modpush.parts import find_part, part_module

ROBOTS: dict[str, Robot] = {**UR_ROBOTS, PANDA.name: PANDA}
"""The robots that the library brings, by name."""


def find_robot(robot: str | Robot) -> Robot:
    """A robot by name, by `"module:name"`, or passed through.

    Raises:
        ValueError: If there is no such robot (the known ones are listed), or it is no `Robot`.
    """
    found: Any = find_part("robot", robot, ROBOTS)
    if not isinstance(found, Robot):
        raise ValueError(f"robot must be a Robot, got {_what(robot, found)}.")
    return found


def find_tool(tool: str | Tool) -> Tool:
    """A tool by name, by `"module:name"`, or passed through.

    Raises:
        ValueError: If there is no such tool (the known ones are listed), or it is no `Tool`.
    """
    found: Any = find_part("tool", tool, TOOLS)
    if not isinstance(found, Tool):
        raise ValueError(f"tool must be a Tool, got {_what(tool, found)}.")
    return found


def _what(given: Any, found: Any) -> str:
    """A part of another type in a few words; its text may be long."""
    kind = type(found).__name__
    return f"a {kind} from {given!r}" if isinstance(given, str) else f"a {kind}"


def check_robot(who: str, robot: Any) -> None:
    """Refuse what cannot be a robot, without importing anything.

    Args:
        who: What has the robot, for the error message.
        robot: A name, `"module:name"`, or a `Robot`.

    Raises:
        ValueError: If it is none of them; the message lists the known names.
    """
    if not (robot in [*ROBOTS] or isinstance(robot, Robot) or part_module(robot) is not None):
        raise ValueError(
            f"{who}: robot must be one of {[*ROBOTS]}, 'module:name' of a module "
            f"that Python can import, or a Robot, got {robot!r}."
        )


def check_tool(who: str, tool: Any) -> None:
    """Refuse what cannot be a tool, without importing anything; see `check_robot`."""
    if not (tool in [*TOOLS] or isinstance(tool, Tool) or part_module(tool) is not None):
        raise ValueError(
            f"{who}: tool must be one of {[*TOOLS]}, 'module:name' of a module that "
            f"Python can import, or a Tool, got {tool!r}."
        )
