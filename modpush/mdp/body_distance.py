"""Distances of tool and object from obstacles, compiled."""

import math

import numpy as np
from numpy.typing import NDArray

from modpush._kernels import njit
from modpush.mdp.push_prediction import Pose, PushedScene


@njit()
def distance(
    distances: NDArray[np.float32], grid: NDArray[np.float64], x: float, y: float
) -> float:
    """Distance of a point from the nearest blocked cell, between the cells' centres interpolated [m]."""
    height, width = distances.shape
    u = min(max(grid[0] - y * grid[2], 0.0), width - 1.001)
    v = min(max(grid[1] - x * grid[2], 0.0), height - 1.001)
    i, j = int(v), int(u)
    a, b = v - i, u - j
    upper = (1 - b) * distances[i, j] + b * distances[i, j + 1]
    lower = (1 - b) * distances[i + 1, j] + b * distances[i + 1, j + 1]
    return float((1 - a) * upper + a * lower - 0.5 / grid[2])


@njit()
def nearest(
    distances: NDArray[np.float32],
    grid: NDArray[np.float64],
    points: NDArray[np.float64],
    pose: Pose,
    enough: float,
) -> float:
    """Distance of the nearest of some points of a body from a blocked cell; about it beyond `enough` [m].

    The points `[m, 2]` are in the body's axes [m], the first the farthest from its origin.
    """
    x, y, yaw = pose
    least = distance(distances, grid, x, y)
    if least - math.hypot(points[0, 0], points[0, 1]) >= enough:
        return enough
    c, s = math.cos(yaw), math.sin(yaw)
    for i in range(len(points)):
        u, v = x + c * points[i, 0] - s * points[i, 1], y + s * points[i, 0] + c * points[i, 1]
        least = min(least, distance(distances, grid, u, v))
    return least


@njit()
def struck(
    scene: PushedScene, points: NDArray[np.float64], pose: Pose, steps: float, clearance: float
) -> float:
    """By how much a body is too near to where the moving obstacle will be after some steps [m]."""
    way = steps if steps <= scene.turn else 2 * scene.turn - steps
    there = (pose[0] - scene.drift[0] * way, pose[1] - scene.drift[1] * way, pose[2])
    return max(0.0, clearance - nearest(scene.moving, scene.grid, points, there, clearance))


@njit()
def excess(
    scene: PushedScene, points: NDArray[np.float64], pose: Pose, steps: float, clearance: float
) -> float:
    """By how much a body is too near to an obstacle, as it stands or will after some steps [m]."""
    most = max(0.0, clearance - nearest(scene.distances, scene.grid, points, pose, clearance))
    if len(scene.moving):
        most = max(most, struck(scene, points, pose, steps, clearance))
    return most


@njit()
def outside(scene: PushedScene, pose: Pose) -> float:
    """By how much the object's centre is outside the area into which it may be pushed [m]."""
    x0, y0, x1, y1 = scene.inner
    return max(0.0, max(x0 - pose[0], pose[0] - x1), max(y0 - pose[1], pose[1] - y1))
