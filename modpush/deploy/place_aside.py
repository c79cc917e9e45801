"""`place_aside`: a place of the tool from which the arm does not hide the object."""

import math

import numpy as np
from numpy.typing import NDArray

from modpush.deploy.perception import Perceived, Sees
from modpush.envs.robot.control import MotionConfig

_DISTANCES = 0.10, 0.18  # from the tip's present place [m]
_DIRECTIONS = 12
_AWAY = 0.2
"""Least cosine of the angle between the way and the direction away from the object."""
_ROOM = 0.05
"""Distance that the tip keeps from obstacles, if it is not nearer already [m]."""
_ENOUGH = 0.5
"""Share of the object's top that may be hidden where another place is further away."""

Floats = NDArray[np.float64]


def place_aside(
    perception: Sees,
    seen: Perceived,
    joints: Floats,
    tip_height: float,
    motion: MotionConfig,
) -> Floats | None:
    """The nearest place (x, y) of the tip at which the camera sees enough of the object, or the most.

    The straight way there leads away from the object and past the known obstacles. `joints` are the
    present angles [rad]; the tip keeps its height [m] and the workspace of `motion`.

    Returns:
        `[2]` [m]; None if there is no such way.
    """
    robot, object_pose, tip = perception.robot, np.array(seen.object.pose), np.array(seen.tip_pose)
    angles = np.arange(_DIRECTIONS) * (2 * math.pi / _DIRECTIONS)
    directions = np.column_stack([np.cos(angles), np.sin(angles)])
    away = (tip - object_pose)[:2] / max(1e-6, math.dist(tip[:2], object_pose[:2]))
    directions = directions[directions @ away >= _AWAY]
    places = np.concatenate([tip[:2] + distance * directions for distance in _DISTANCES])
    inside = ((places >= motion.low) & (places <= motion.high)).all(1)
    obstacles = perception.obstacle_cells()
    inside &= np.array([_has_room(tip[:2], place, obstacles) for place in places], dtype=bool)
    height = tip_height + perception.tool.length
    poses = np.array([[x, y, height, tip[2]] for x, y in places]) - (*robot.base, 0.0)
    joints_there, found = robot.inverse(poses, joints[None].repeat(len(places), 0))
    best, least = None, (math.inf, math.inf)
    for number in np.flatnonzero(inside & found):
        hidden = perception.hidden_by_arm(object_pose, joints_there[number])
        near = number < len(directions)
        score = (0.0 if near else 1.0, hidden) if hidden <= _ENOUGH else (2.0, hidden)
        if score < least:
            best, least = places[number], score
    return best


def _has_room(start: Floats, end: Floats, obstacles: Floats) -> bool:
    """True if no obstacle's cell `[n, 2]` is near the way from start to end."""
    if not len(obstacles):
        return True
    way = start + np.linspace(0.0, 1.0, 10)[:, None] * (end - start)
    gaps = np.linalg.norm(way[:, None] - obstacles, axis=-1).min(1)
    return bool(gaps.min() >= min(_ROOM, gaps[0]) - 0.002)
