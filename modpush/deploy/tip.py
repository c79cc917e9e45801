"""Pose of the tool's tip, and its contact with the object."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from modpush.deploy.outlines import overlap, place
from modpush.deploy.push_motion import tool_outlines
from modpush.envs.robot.robot import Robot, Tool
from modpush.envs.scenes.objects import PushedObject


def tip_transform(robot: Robot, tool: Tool, joints: NDArray[np.float64]) -> NDArray[np.float64]:
    """Transform of the tool's tip by forward kinematics, `[4, 4]` in the base frame [m].

    Its z axis points out of the flange, x is the tool's own.

    Args:
        robot: The arm.
        tool: Its tool.
        joints: Angles of the joints, `[n]` [rad].
    """
    transform: NDArray[np.float64] = robot.link_transforms(joints)[-1].copy()
    transform[:3, 3] += tool.length * transform[:3, 2]
    return transform


def touches(
    tool: Tool,
    tip: NDArray[np.float64],
    item: PushedObject,
    object_pose: Sequence[float],
    tolerance: float,
) -> bool:
    """True if the tool is so near to the object that it counts as touching.

    Args:
        tool: The tool.
        tip: Transform of its tip, `[4, 4]`.
        item: The object, which stands on the table.
        object_pose: x, y, yaw of the object [m, m, rad].
        tolerance: Largest distance that counts [m]; the error of the object's pose.
    """
    flange = tip.copy()
    flange[:3, 3] -= tool.length * tip[:3, 2]
    for outline in item.footprints():
        placed = np.empty_like(outline)
        place(outline, *object_pose, placed)
        for solid in tool_outlines(tool, flange, item.height):
            if overlap(solid, placed)[0] >= -tolerance:
                return True
    return False
