"""Inverse kinematics of any arm with the tool down, by damped least squares, compiled.

Source: Nakamura and Hanafusa 1986 (damping), with the damping of Sugihara 2011, which vanishes with the
error; joints at a limit are held there, as in Baerlocher and Boulic 2004.
"""

import math

import numpy as np
from numpy.typing import NDArray

from modpush._kernels import njit
from modpush.envs.robot.robot import Chain

_ITERATIONS = 100
_TOLERANCE = 1e-9  # of the pose [m, rad]
_DRAW = 0.02  # by which home draws a joint in one solution, where the pose lets it [rad]
_LARGEST_STEP = 0.3  # of a joint in an iteration [rad]
_DAMPING = 1e-12
_NEAR = 0.01  # error of the pose at which the damping hardly matters


class DampedLeastSquares:
    """Joint angles near `last` that hold the tool straight down at a pose.

    An arm with more joints than it needs is drawn back to home while it moves, by a little each time; its
    first and last joint are not, since they follow the place and the yaw of the pose.
    It is an `InverseKinematics`; a pose without a solution gets the angles of `last`. A pose takes some 5
    iterations of 5 microseconds, and one that has no solution 100.
    """

    def __init__(self, chain: Chain) -> None:
        self.chain = chain

    def __call__(
        self, pose: NDArray[np.float64], last: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        return _solve(pose, last, *self.chain)


@njit()
def _solve(
    pose: NDArray[np.float64],
    last: NDArray[np.float64],
    frames: NDArray[np.float64],
    limits: NDArray[np.float64],
    home: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    joints, found = last.copy(), np.zeros(len(pose), np.bool_)
    n = len(home)
    axes, transform = np.empty((n, 6)), np.empty((4, 4))
    error, move = np.empty(6), np.empty(n)
    for i in range(len(pose)):
        q = joints[i]
        for j in range(n):
            q[j] = min(max(q[j], limits[j, 0]), limits[j, 1])
        drawn = False
        for _ in range(_ITERATIONS):
            _forward(q, frames, axes, transform)
            size = _error(pose[i], transform, error)
            if size < _TOLERANCE and drawn:
                found[i] = True
                break
            # Once, so that it stays near `last`; and near the pose, where the damping hardly matters.
            draw = _DRAW if size < _NEAR and not drawn else 0.0
            drawn |= draw > 0
            largest = _motion(q, axes, transform, error, limits, home, size, draw, move)
            scale = min(1.0, _LARGEST_STEP / max(largest, 1e-12))
            for j in range(n):
                q[j] = min(max(q[j] + scale * move[j], limits[j, 0]), limits[j, 1])
        if not found[i]:
            q[:] = last[i]
    return joints, found


@njit()
def _forward(
    q: NDArray[np.float64],
    frames: NDArray[np.float64],
    axes: NDArray[np.float64],
    transform: NDArray[np.float64],
) -> None:
    """Write each joint's axis and origin in the base's frame, `[n, 6]`, and the flange's transform."""
    step = np.empty((3, 4))
    for k in range(len(frames)):
        frame = frames[k]
        for r in range(3):
            for c in range(4):
                if k == 0:
                    step[r, c] = frame[r, c]
                else:
                    step[r, c] = (
                        transform[r, 0] * frame[0, c]
                        + transform[r, 1] * frame[1, c]
                        + transform[r, 2] * frame[2, c]
                    )
            if k > 0:
                step[r, 3] += transform[r, 3]
        turn, rise = (math.cos(q[k]), math.sin(q[k])) if k < len(q) else (1.0, 0.0)
        for r in range(3):
            transform[r, 0] = step[r, 0] * turn + step[r, 1] * rise
            transform[r, 1] = step[r, 1] * turn - step[r, 0] * rise
            transform[r, 2], transform[r, 3] = step[r, 2], step[r, 3]
            if k < len(q):
                axes[k, r], axes[k, 3 + r] = step[r, 2], step[r, 3]


@njit()
def _error(
    pose: NDArray[np.float64], transform: NDArray[np.float64], error: NDArray[np.float64]
) -> float:
    """Write the translation and the rotation vector from the flange to a pose; returns their norm."""
    c, s = math.cos(pose[3]), math.sin(pose[3])
    wanted = np.array([[c, s, 0.0], [s, -c, 0.0], [0.0, 0.0, -1.0]])  # x along yaw, z down
    rotation = np.zeros((3, 3))  # from the flange's present axes to the wanted ones
    for r in range(3):
        error[r] = pose[r] - transform[r, 3]
        for k in range(3):
            for m in range(3):
                rotation[r, k] += wanted[r, m] * transform[k, m]
    x = (rotation[2, 1] - rotation[1, 2]) / 2
    y = (rotation[0, 2] - rotation[2, 0]) / 2
    z = (rotation[1, 0] - rotation[0, 1]) / 2
    sine, cosine = math.sqrt(x * x + y * y + z * z), (np.trace(rotation) - 1) / 2
    angle = math.atan2(sine, cosine)
    if sine < 1e-6 and cosine < 0:  # half a turn, about any axis: about the vertical one
        x, y, z, sine = 0.0, 0.0, 1.0, 1.0
    scale = angle / sine if sine > 1e-12 else 1.0
    error[3], error[4], error[5] = x * scale, y * scale, z * scale
    return math.sqrt((error * error).sum())


@njit()
def _motion(
    q: NDArray[np.float64],
    axes: NDArray[np.float64],
    transform: NDArray[np.float64],
    error: NDArray[np.float64],
    limits: NDArray[np.float64],
    home: NDArray[np.float64],
    size: float,
    draw: float,
    move: NDArray[np.float64],
) -> float:
    """Write the joints' motion against an error; returns its largest part [rad].

    Home draws each joint by at most `draw`, as far as the pose lets it. A joint that would pass its limit
    moves up to it and no farther, and the others make up for it.
    """
    n = len(q)
    jacobian, held = np.empty((6, n)), np.zeros(n, np.bool_)
    for j in range(n):
        zx, zy, zz = axes[j, 0], axes[j, 1], axes[j, 2]
        dx, dy = transform[0, 3] - axes[j, 3], transform[1, 3] - axes[j, 4]
        dz = transform[2, 3] - axes[j, 5]
        jacobian[0, j], jacobian[1, j] = zy * dz - zz * dy, zz * dx - zx * dz
        jacobian[2, j] = zx * dy - zy * dx
        jacobian[3, j], jacobian[4, j], jacobian[5, j] = zx, zy, zz
    wish = np.zeros(n)
    for j in range(
        1, n - 1
    ):  # the first and the last one follow the pose: where it is, and its yaw
        wish[j] = min(max(home[j] - q[j], -draw), draw)
    for _ in range(n):
        matrix, rest = np.zeros((6, 6)), error.copy()
        for r in range(6):
            matrix[r, r] = size * size / 2 + _DAMPING
            for j in range(n):
                rest[r] -= jacobian[r, j] * wish[j]
                if not held[j]:
                    for c in range(6):
                        matrix[r, c] += jacobian[r, j] * jacobian[c, j]
        forces = np.linalg.solve(matrix, rest)
        passed = False
        for j in range(n):
            if held[j]:
                continue
            move[j] = wish[j] + (jacobian[:, j] * forces).sum()
            beyond = min(max(q[j] + move[j], limits[j, 0]), limits[j, 1]) - q[j]
            if abs(beyond - move[j]) > 1e-12:
                held[j], passed = True, True
                wish[j] = move[j] = beyond
        if not passed:
            break
    return np.abs(move).max()
