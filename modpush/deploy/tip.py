"""Where the tool's tip is, and whether it touches the object."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from modpush.envs.robot.robot import Robot, Tool
from modpush.envs.scenes.objects import PushedObject

__all__ = ["polygon_distance", "tip_transform", "touches"]


def tip_transform(robot: Robot, tool: Tool, joints: NDArray[np.float64]) -> NDArray[np.float64]:
    """Transform of the tool's tip by forward kinematics, `[4, 4]` in the base frame [m].

    Its z axis points out of the flange, x is the tool's own.

    Args:
        robot: The arm.
        tool: Its tool.
        joints: Angles of the joints, `[n]` [rad].
    """
    transform = robot.link_transforms(joints)[-1].copy()
    transform[:3, 3] += tool.length * transform[:3, 2]
    return transform


def touches(
    tool: Tool,
    tip_pose: Sequence[float],
    item: PushedObject,
    object_pose: Sequence[float],
    tolerance: float,
) -> bool:
    """Whether the tip is as near to the object as if it touched it, seen from above.

    Args:
        tool: The tool, of which only the tip counts.
        tip_pose: x, y, yaw of the tip [m, m, rad].
        item: The object.
        object_pose: x, y, yaw of the object [m, m, rad].
        tolerance: Largest distance that counts [m]; the error of the object's pose.
    """
    half_x, half_y = tool.tip_half_extents
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * (half_x, half_y)
    tip = _placed(corners, tip_pose)
    outlines = (_placed(outline, object_pose) for outline in item.footprints())
    return any(polygon_distance(tip, outline) <= tolerance for outline in outlines)


def _placed(points: NDArray[np.float64], pose: Sequence[float]) -> NDArray[np.float64]:
    x, y, yaw = pose
    turn = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
    return points @ turn + (x, y)


def polygon_distance(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    """Distance of two convex polygons `[n, 2]`, counter-clockwise; 0 where they overlap [m]."""
    if not (_separated(one, other) or _separated(other, one)):
        return 0.0
    return min(_corner_distance(one, other), _corner_distance(other, one))


def _separated(one: NDArray[np.float64], other: NDArray[np.float64]) -> bool:
    """Whether all of the other polygon lies beyond one of the edges."""
    edges = np.roll(one, -1, axis=0) - one
    outward = np.stack([edges[:, 1], -edges[:, 0]], -1)
    beyond = np.einsum("ed,ecd->ec", outward, other[None] - one[:, None])
    return bool((beyond > 0).all(1).any())


def _corner_distance(corners: NDArray[np.float64], polygon: NDArray[np.float64]) -> float:
    """Smallest distance of corners from the edges of a polygon."""
    edges = np.roll(polygon, -1, axis=0) - polygon
    offsets = corners[:, None] - polygon[None]
    along = np.einsum("ced,ed->ce", offsets, edges) / np.square(edges).sum(1)
    nearest = along.clip(0, 1)[..., None] * edges
    return float(np.linalg.norm(offsets - nearest, axis=-1).min())
