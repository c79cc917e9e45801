"""Colour pictures of a scene in MuJoCo from the side, by casting rays, which needs no renderer."""

import functools
import math

import mujoco
import numpy as np
from numpy.typing import NDArray

from modpush.envs.outcome import GOAL_THRESHOLD
from modpush.geometry.camera_model import CameraModel

_AIM, _EYE, _SIZE, _FIELD_OF_VIEW = (0.40, 0.0, 0.05), (1.35, 0.75, 0.85), 512, 0.75
"""The camera, the same as SAPIEN's [m, px, rad]."""
_LAMP = np.array([0.9, 0.8, 2.2])
"""Place of the light [m]."""
_AMBIENT = 0.45
"""Brightness of a surface that the light does not reach."""
_SKY, _TABLE, _GOAL = (0.96, 0.97, 0.98), (0.93, 0.91, 0.87), (0.10, 0.75, 0.20)
_FAR = 10.0  # [m]
_IN_SHADOW = 1e-3  # least distance from what is in the light's way [m]


@functools.cache
def _rays() -> NDArray[np.float64]:
    """Direction of each pixel, of length 1, `[H * W, 3]`."""
    focal_length = 0.5 * _SIZE / math.tan(0.5 * _FIELD_OF_VIEW)
    camera = CameraModel.looking_at(_AIM, _EYE, (_SIZE, _SIZE), focal_length)
    rays = camera.rays.reshape(-1, 3).astype(np.float64)
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def draw_picture(
    model: "mujoco.MjModel", data: "mujoco.MjData", goal: tuple[float, float]
) -> NDArray[np.uint8]:
    """The present picture, `[H, W, 3]`, with a disc at the goal.

    Args:
        model: The episode's model.
        data: Its state.
        goal: Position of the goal [m].
    """
    rays, eye = _rays(), np.array(_EYE)
    geoms, distance, normals = _cast(model, data, eye, rays)
    hit = geoms >= 0
    points = eye + np.where(hit, distance, _FAR)[:, None] * rays
    to_lamp = _LAMP - points
    away = np.linalg.norm(to_lamp, axis=1)
    to_lamp /= away[:, None]
    _, lit, _ = _cast(model, data, _LAMP, -to_lamp)  # as far as the light comes
    facing = np.where(lit > away - _IN_SHADOW, (normals * to_lamp).sum(1).clip(0), 0.0)
    colors = model.geom_rgba[geoms, :3]
    table = hit & (model.geom_type[geoms] == mujoco.mjtGeom.mjGEOM_PLANE)
    at_goal = np.linalg.norm(points[:, :2] - goal, axis=1) <= GOAL_THRESHOLD
    colors[table], colors[table & at_goal] = _TABLE, _GOAL
    shaded = colors * (_AMBIENT + (1 - _AMBIENT) * facing)[:, None]
    picture = np.where(hit[:, None], shaded, _SKY)
    return np.rint(255 * picture).astype(np.uint8).reshape(_SIZE, _SIZE, 3)


def _cast(
    model: "mujoco.MjModel",
    data: "mujoco.MjData",
    start: NDArray[np.float64],
    rays: NDArray[np.float64],
) -> tuple[NDArray[np.int32], NDArray[np.float64], NDArray[np.float64]]:
    """What rays from one point meet first: geoms (-1: none), distance [m] and surface's normal."""
    n = len(rays)
    geoms, distance, normals = np.empty(n, np.int32), np.empty(n), np.zeros(3 * n)
    mujoco.mj_multiRay(
        model, data, start, rays.ravel(), None, True, -1, geoms, distance, normals, n, _FAR
    )
    return geoms, distance, normals.reshape(n, 3)
