"""`within_reach`: the episodes that an arm can begin."""

from collections.abc import Iterable

from modpush._checks import check_instance
from modpush.envs.robot.control import start_joints
from modpush.envs.robot.named import find_robot, find_tool
from modpush.envs.robot.robot import Robot, Tool
from modpush.envs.scenes.arm_room import check_arm_is_free
from modpush.envs.scenes.objects import get_object
from modpush.envs.scenes.scenario import Scenario


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
        ValueError: If there is no such robot or tool.
    """
    robot, tool, kept = find_robot(robot), find_tool(tool), []
    for scenario in scenarios:
        check_instance("scenarios", scenario, Scenario)
        height = get_object(scenario.pushed_object).tool_height
        try:
            start_joints(robot, tool, scenario.tool_pose, height)
            check_arm_is_free("start", scenario, height, tool, robot)
        except ValueError:
            continue
        kept.append(scenario)
    return kept
