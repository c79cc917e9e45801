"""The inverse kinematics of Universal Robots' arms with the tool down, in closed form, compiled.

Source: the geometry of the solution is the textbook one for an arm with three parallel axes and a wrist
that does not intersect in a point.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modpush._kernels import njit


@dataclass(frozen=True)
class ThreeParallelAxes:
    """Joint angles that hold the tool straight down at a pose, in the working branch.

    With the tool down the wrist's bend is a right angle and the last joint follows yaw linearly,
    so the solution is continuous over the whole workspace and in an unwrapped yaw: no branch is
    searched and none can be jumped. Of the arm's eight branches two keep the elbow over the table (25 cm
    and more on a UR5) and reach the whole workspace; this is the one whose shoulder angle does not wrap
    there. It is an `InverseKinematics`; poses out of reach get the angles of the nearest reach.

    Args:
        d: Denavit-Hartenberg offsets of the six joints [m].
        a: Denavit-Hartenberg lengths of the six joints [m].
    """

    d: tuple[float, ...]
    a: tuple[float, ...]

    def __call__(
        self, pose: NDArray[np.float64], last: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """See `InverseKinematics`; the solution does not depend on `last`."""
        if pose.ndim != 2 or pose.shape[1] != 4:
            raise ValueError(
                f"ThreeParallelAxes: pose must be [N, 4] (x, y, z, yaw), got {pose.shape}."
            )
        d1, _, _, d4, d5, d6 = self.d
        return _solve(pose, d1, self.a[1], self.a[2], d4, d5, d6)


@njit()
def _solve(
    pose: NDArray[np.float64],
    d1: float,
    a2: float,
    a3: float,
    d4: float,
    d5: float,
    d6: float,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    joints, found = np.empty((len(pose), 6)), np.empty(len(pose), np.bool_)
    for i in range(len(pose)):
        x, y, height, yaw = pose[i]
        q = joints[i]
        radius_sq = x * x + y * y
        lever = d4 / math.sqrt(max(radius_sq, 1e-12))
        q[0] = math.atan2(y, x) - math.acos(min(max(lever, -1.0), 1.0)) + math.pi / 2
        # How far the wrist is out along the arm's plane, less the offset of axis 5 that lies in it.
        r = math.sqrt(max(radius_sq - d4 * d4, 0.0)) - d5
        h = height + d6 - d1
        bend = (r * r + h * h - a2 * a2 - a3 * a3) / (2 * a2 * a3)
        q[2] = -math.acos(min(max(bend, -1.0), 1.0))
        q[1] = math.atan2(h, r) - math.atan2(a3 * math.sin(q[2]), a2 + a3 * math.cos(q[2]))
        q[3] = -1.5 * math.pi - q[1] - q[2]  # keeps axis 5 level, pointing outwards
        q[4] = math.pi / 2
        q[5] = q[0] - yaw - math.pi / 2
        within = abs(lever) <= 1 + 1e-9 and abs(bend) <= 1 + 1e-9  # forgives rounding errors
        found[i] = within and radius_sq > 1e-12 and abs(q[5]) <= 2 * math.pi
    return joints, found
