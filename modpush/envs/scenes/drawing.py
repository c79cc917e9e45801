"""A drawn top view of an episode: what there is to look at without a renderer."""

import math
from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from modpush.envs.outcome import GOAL_THRESHOLD
from modpush.envs.robot.named import find_tool
from modpush.envs.robot.robot import Tool
from modpush.envs.scenes.objects import PushedObject, get_object
from modpush.envs.scenes.scenario import Scenario
from modpush.geometry.workspace import WORKSPACE

_SHIFT = 4  # fractional bits of cv2's coordinates
_LEGEND = ("goal", "start", "object", "tool", "planned")
"""Colours that the line below a picture with a caption explains."""
COLORS = {
    "table": (244, 241, 235),
    "workspace": (222, 216, 206),
    "inflated": (205, 206, 208),
    "obstacle": (96, 102, 112),
    "goal": (60, 160, 75),
    "start": (214, 60, 50),
    "object": (40, 90, 200),
    "tool": (20, 20, 20),
    "planned": (200, 40, 190),
    "text": (40, 40, 40),
}
"""Red, green and blue, 0 to 255, of what pictures show."""


# What part of the table is shown, from its lower to its upper corner [m], and at what scale. Up is +x,
# left is +y, as in the depth image.
_LOW, _HIGH, _PIXELS_PER_METRE = (0.0, -0.5), (0.95, 0.5), 560.0
_HEIGHT, _WIDTH = (  # even, as video codecs want it
    int((high - low) * _PIXELS_PER_METRE) // 2 * 2 for low, high in zip(_LOW, _HIGH, strict=True)
)


def to_pixels(points: NDArray[np.float64]) -> NDArray[np.int32]:
    """Points `[..., 2]` [m] as cv2's fixed-point pixels `[..., 2]`."""
    points = np.asarray(points, dtype=np.float64)
    u = (_HIGH[1] - points[..., 1]) * _PIXELS_PER_METRE
    v = (_HIGH[0] - points[..., 0]) * _PIXELS_PER_METRE
    return np.round(np.stack([u, v], -1) * (1 << _SHIFT)).astype(np.int32)


def draw_top_view(
    scenario: Scenario,
    object_pose: Sequence[float],
    ee_pose: Sequence[float],
    *,
    object_path: NDArray[np.float64] | None = None,
    ee_path: NDArray[np.float64] | None = None,
    planned_path: NDArray[np.float64] | None = None,
    subgoal: Sequence[float] | None = None,
    inflation: float = 0.0,
    obstacle_poses: NDArray[np.float64] | None = None,
    caption: str = "",
    tool: str | Tool = "2f85",
    objects: Mapping[str, PushedObject] | None = None,
    position_tolerance: float = GOAL_THRESHOLD,
) -> NDArray[np.uint8]:
    """Draw a moment of an episode: start red, goal green, object blue, tool black (as in the paper).

    Args:
        scenario: What the episode started from.
        object_pose, ee_pose: x, y, yaw of the object and of the tool's tip now [m, m, rad].
        object_path, ee_path: Their positions until now, `[n, 2]` [m].
        planned_path: A planned way, `[n, 2]` [m], magenta.
        subgoal: x, y of the present sub-goal [m], a magenta disc.
        inflation: Obstacles get a light rim of this width, where the object's centre cannot be [m].
        obstacle_poses: Present poses of the obstacles, `[n, 3]`; by default those at the start.
        caption: Lines at the top; with them goes a legend of the colours at the bottom.
        tool: The arm's tool.
        objects: Your own objects by name, as in `PushEnv.pushed_objects`.
        position_tolerance: Radius of the disc around the goal [m]. A goal pose is drawn as the object's
            outline there.

    Returns:
        `[H, W, 3]` uint8 RGB.
    """
    image = np.full((_HEIGHT, _WIDTH, 3), COLORS["table"], dtype=np.uint8)
    _outline(image, WORKSPACE.corners(), "workspace", 2)
    poses = obstacle_poses if obstacle_poses is not None else [o.pose for o in scenario.obstacles]
    outlines = [
        _placed(_rectangle(obstacle.size[0] / 2, obstacle.size[1] / 2), pose)
        for obstacle, pose in zip(scenario.obstacles, poses, strict=True)
    ]
    _draw_obstacles(image, scenario, outlines, inflation)
    _disc(image, scenario.goal_position, position_tolerance, "goal", thickness=2)
    _disc(image, scenario.goal_position, 0.006, "goal")
    footprints = get_object(scenario.pushed_object, objects).footprints()
    for part in footprints:
        if scenario.goal_yaw is not None:
            _outline(image, _placed(part, (*scenario.goal_position, scenario.goal_yaw)), "goal", 2)
        _outline(image, _placed(part, scenario.object_pose), "start", 2)
    for path, color in ((planned_path, "planned"), (ee_path, "tool"), (object_path, "object")):
        if path is not None and len(path) > 1:
            points = [to_pixels(np.asarray(path)[:, :2])]
            cv2.polylines(image, points, False, COLORS[color], 2, cv2.LINE_AA, _SHIFT)
    if subgoal is not None:
        _disc(image, subgoal, 0.008, "planned")
    for part in footprints:
        _fill(image, _placed(part, object_pose), "object")
    _fill(image, _placed(_rectangle(*find_tool(tool).tip_half_extents), ee_pose), "tool")
    if caption:
        for k, line in enumerate(caption.splitlines()):
            _write(image, line, (10, 24 + 24 * k))
        for k, name in enumerate(_LEGEND):
            x, y = 12 + 108 * k, _HEIGHT - 14
            cv2.circle(image, (x, y - 5), 6, COLORS[name], -1, cv2.LINE_AA)
            _write(image, "path" if name == "planned" else name, (x + 12, y))
    return image


def _draw_obstacles(
    image: NDArray[np.uint8],
    scenario: Scenario,
    outlines: Sequence[NDArray[np.float64]],
    inflation: float,
) -> None:
    if inflation > 0:
        # A thick line has round joints, so that this is the exact sum of rectangle and disc.
        for outline in outlines:
            _outline(image, outline, "inflated", round(2 * inflation * _PIXELS_PER_METRE))
    for obstacle in scenario.obstacles:
        if obstacle.motion is not None:
            _outline(image, obstacle.ends(), "obstacle", 2)  # the line of its patrol
            for end in obstacle.ends():
                _disc(image, end.tolist(), 0.008, "obstacle")
    for outline in outlines:
        _fill(image, outline, "obstacle")


def _write(image: NDArray[np.uint8], text: str, place: tuple[int, int]) -> None:
    font, color = cv2.FONT_HERSHEY_SIMPLEX, COLORS["text"]
    cv2.putText(image, text, place, font, 0.6, color, 1, cv2.LINE_AA)


def _rectangle(half_length: float, half_width: float) -> NDArray[np.float64]:
    return np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * [half_length, half_width]


def _placed(outline: NDArray[np.float64], pose: Sequence[float]) -> NDArray[np.float64]:
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return outline @ np.array([[c, s], [-s, c]]) + np.array(pose[:2])


def _fill(image: NDArray[np.uint8], outline: NDArray[np.float64], name: str) -> None:
    cv2.fillPoly(image, [to_pixels(outline)], COLORS[name], cv2.LINE_AA, _SHIFT)


def _outline(
    image: NDArray[np.uint8], outline: NDArray[np.float64], name: str, thickness: int
) -> None:
    points = [to_pixels(outline)]
    cv2.polylines(image, points, True, COLORS[name], thickness, cv2.LINE_AA, _SHIFT)


def _disc(
    image: NDArray[np.uint8],
    center: Sequence[float],
    radius: float,
    name: str,
    thickness: int = -1,
) -> None:
    u, v = to_pixels(np.array(center)).tolist()
    scaled = round(radius * _PIXELS_PER_METRE * (1 << _SHIFT))
    cv2.circle(image, (u, v), scaled, COLORS[name], thickness, cv2.LINE_AA, _SHIFT)
