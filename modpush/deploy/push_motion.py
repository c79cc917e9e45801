"""`PushMotion`: where a pushed object comes to lie when the tool moves.

A push is quasi-static: friction on the table stops the object at once. With the ellipsoid as limit
surface, a force f at the place r, within the cone of friction about the contact's normal, moves the
object by a multiple of (f, r x f / c^2), where c is the ratio of the largest moment to the largest
force of that friction.
Source: Lynch, Maekawa and Tanie, Manipulation and active sensing by pushing using tactile feedback, 1992.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from modpush._kernels import njit
from modpush.deploy.outlines import overlap, padded, place, points_within
from modpush.envs.robot.robot import Tool
from modpush.envs.robot.urdf import extent
from modpush.envs.scenes.objects import PushedObject
from modpush.geometry.footprint import outline_of
from modpush.geometry.shapes import Primitive

_STEP = 0.001  # of the tool's corners between two corrections of the object's pose [m]
_FRICTION = 0.25  # of tool and object, as `FRICTION` has it
_CORRECTIONS = 4  # after each of its steps, since a side may touch at both ends in turn

Floats = NDArray[np.float64]


class PushMotion:
    """Predicts the object's pose from the motion of the tool.

    Args:
        item: The pushed object.
    """

    def __init__(self, item: PushedObject) -> None:
        self._outlines, self._counts = padded(item.footprints(num_arc=24))
        # Largest moment per largest force of even friction under the object about its origin [m].
        self._lever = float(np.linalg.norm(points_within(item, 64), axis=1).mean())

    def predict(
        self, pose: Floats, before: list[NDArray[np.float64]], after: list[NDArray[np.float64]]
    ) -> tuple[Floats, float]:
        """The object's pose (x, y, yaw) after a motion of the tool [m, m, rad].

        `before` and `after` are the outlines of the tool's solids at the object's height, from
        `tool_outlines`.

        Returns:
            The pose after it, and the least distance of tool and object [m], negative in contact.
        """
        pose = np.array(pose, dtype=np.float64)
        gap = np.inf
        for first, last in zip(before, after, strict=True):
            steps = max(1, math.ceil(float(np.linalg.norm(last - first, axis=1).max()) / _STEP))
            rest = self._outlines, self._counts, self._lever, _CORRECTIONS
            gap = min(gap, _push(pose, first, last, min(steps, 100), *rest))
        return pose, gap


def tool_outlines(tool: Tool, flange: Floats, height: float) -> list[NDArray[np.float64]]:
    """Outlines of a tool's solids that reach below a height [m], counter-clockwise, `[n, 2]` each [m].

    `flange` is its pose in the base frame, `[4, 4]`.
    """
    found = []
    for part in tool.shapes:
        outline, low, high = _prism_around(part)
        ends = [np.column_stack([outline, np.full(len(outline), z)]) for z in (low, high)]
        corners = np.concatenate(ends) @ flange[:3, :3].T + flange[:3, 3]
        if corners[:, 2].min() < height:
            lower = corners[: len(outline), 2].mean() < corners[len(outline) :, 2].mean()
            end = corners[: len(outline), :2] if lower else corners[len(outline) :, :2]
            # Seen from above, a tool that points down is mirrored.
            found.append(np.ascontiguousarray(end[::-1] if flange[2, 2] < 0 else end))
    return found


def touches(
    tool: Tool, flange: Floats, item: PushedObject, object_pose: Sequence[float], tolerance: float
) -> bool:
    """True if the tool is so near to the object, on the table, that it counts as touching.

    The flange's pose `[4, 4]` and the object's (x, y, yaw) are in the base frame; `tolerance` [m] is the
    largest distance that counts, the error of the object's pose.
    """
    solids = tool_outlines(tool, flange, item.height)
    for outline in item.footprints():
        placed = np.empty_like(outline)
        place(outline, *object_pose, placed)
        if any(overlap(solid, placed)[0] >= -tolerance for solid in solids):
            return True
    return False


def _prism_around(part: Primitive) -> tuple[NDArray[np.float64], float, float]:
    """Outline of a solid, or of a box around a tilted one, seen along z, and its lower and upper end."""
    length, width, height = extent(part)
    x, y, z = part.position
    if part.rpy[:2] == (0.0, 0.0):
        outline = outline_of(part, 16)
    else:
        outline = np.array([x, y]) + 0.5 * np.array(
            [[length, width], [-length, width], [-length, -width], [length, -width]]
        )
    return outline, z - height / 2, z + height / 2


@njit(error_model="numpy")
def _push(
    pose: Floats,
    first: Floats,
    last: Floats,
    steps: int,
    outlines: Floats,
    counts: NDArray[np.int64],
    lever: float,
    corrections: int,
) -> float:
    """Move the object out of the tool's way, in place; returns the least distance of the two [m]."""
    tool, body = np.empty_like(first), np.empty_like(outlines[0])
    before, after = last[1] - last[0], first[1] - first[0]
    turn = math.atan2(
        after[0] * before[1] - after[1] * before[0], after[0] * before[0] + after[1] * before[1]
    )
    gap = np.inf
    for step in range(steps):
        share, mx, my = (step + 1) / steps, 0.0, 0.0
        for i in range(len(first)):
            tool[i, 0] = first[i, 0] + share * (last[i, 0] - first[i, 0])
            tool[i, 1] = first[i, 1] + share * (last[i, 1] - first[i, 1])
            mx, my = mx + tool[i, 0] / len(first), my + tool[i, 1] / len(first)
        for again in range(corrections):
            deepest, nx, ny, px, py = -np.inf, 0.0, 0.0, 0.0, 0.0
            for part in range(len(outlines)):
                n = counts[part]
                place(outlines[part, :n], pose[0], pose[1], pose[2], body[:n])
                found = overlap(tool, body[:n])
                if found[0] > deepest:
                    deepest, nx, ny, px, py = found
            gap = min(gap, -deepest)
            if deepest <= 1e-6:
                break
            along = 0.0  # motion of the tool's side along itself, which friction passes on
            if again == 0:
                vx = (last[:, 0] - first[:, 0]).mean() - turn * (py - my)
                vy = (last[:, 1] - first[:, 1]).mean() + turn * (px - mx)
                along = (vy * nx - vx * ny) / steps
            _move(pose, deepest, along, nx, ny, px - pose[0], py - pose[1], lever)
    return gap


@njit(error_model="numpy")
def _move(
    pose: Floats, out: float, along: float, nx: float, ny: float, rx: float, ry: float, lever: float
) -> None:
    """Move the object such that its point r goes `out` along n, and `along` beside it if friction can."""
    # Moments of unit forces along n and beside it, per lever; each moves r by 1 + its square.
    mn, mt = (rx * ny - ry * nx) / lever, (rx * nx + ry * ny) / lever
    nn, nt, tt = 1.0 + mn * mn, mn * mt, 1.0 + mt * mt
    det = nn * tt - nt * nt
    normal, beside = (tt * out - nt * along) / det, (nn * along - nt * out) / det
    if normal <= 0.0 or abs(beside) > _FRICTION * normal:
        side = math.copysign(_FRICTION, beside)
        normal = out / (nn + side * nt)
        beside = side * normal
    pose[0] += normal * nx - beside * ny
    pose[1] += normal * ny + beside * nx
    pose[2] += (normal * mn + beside * mt) / lever
