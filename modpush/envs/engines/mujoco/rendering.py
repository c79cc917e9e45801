"""`DepthRenderer`: depth images of a scene in MuJoCo; and colour pictures by rays, without a renderer."""

import functools
import importlib
import math
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from modpush._validation import checked_arguments
from modpush.envs.outcome import GOAL_THRESHOLD
from modpush.geometry.camera_model import CameraModel

if TYPE_CHECKING:
    from modpush.envs.engines.mujoco.engine import MujocoEngine

_NEAR, _FAR = 0.05, 5.0
"""Range of depth [m]; a pixel beyond it has no reading."""
_BACKENDS = ("mujoco.egl", "mujoco.osmesa")

_AIM, _EYE, _SIZE, _FIELD_OF_VIEW = (0.40, 0.0, 0.05), (1.35, 0.75, 0.85), 512, 0.75
"""The camera, the same as SAPIEN's [m, px, rad]."""
_LAMP = np.array([0.9, 0.8, 2.2])
"""Place of the light [m]."""
_AMBIENT = 0.45
"""Brightness of a surface that the light does not reach."""
_SKY, _TABLE, _GOAL = (0.96, 0.97, 0.98), (0.93, 0.91, 0.87), (0.10, 0.75, 0.20)
_FARTHEST = 10.0  # [m]
_IN_SHADOW = 1e-3  # least distance from what is in the light's way [m]


class DepthRenderer:
    """Renders the depth image that a calibrated camera has of a scene, arm and distortion included.

    MuJoCo's own renderer draws it where OpenGL can be had without a display (EGL or OSMesa; Debian's
    `libegl1` with Mesa draws on the CPU). Everywhere else, rays are cast, in four times the time. The
    method is `"opengl"`, `"rays"`, or `"auto"` for the first one if it can be had.

    Raises:
        RuntimeError: If `"opengl"` is asked for and cannot be had.
    """

    @checked_arguments
    def __init__(
        self, camera: CameraModel, method: Literal["auto", "opengl", "rays"] = "auto"
    ) -> None:
        self.camera = camera
        if method == "auto":
            method = "opengl" if _gl_context() is not None else "rays"
        elif method == "opengl" and _gl_context() is None:
            raise RuntimeError(
                "DepthRenderer: no OpenGL without a display was found, expected EGL or OSMesa; "
                "method='rays' needs neither."
            )
        self.method: Literal["opengl", "rays"] = method
        self._rays = camera.rays.reshape(-1, 3).astype(np.float64)
        self._lengths = np.linalg.norm(self._rays, axis=1)
        self._directions = self._rays / self._lengths[:, None]
        self._place = np.array(camera.position)
        if method == "opengl":
            self._lay_out_pixels()
        self._model: Any = None

    def _lay_out_pixels(self) -> None:
        """Size of the image without distortion that is drawn, and the pixel of it for each of ours."""
        turn = np.array(self.camera.camera_in_base)[:3, :3]
        x, y = (self._rays @ turn[:, :2]).T
        self._focal_length = max(self.camera.intrinsics[0][0], self.camera.intrinsics[1][1])
        width, height = (
            2 * math.ceil(float(np.abs(side).max()) * self._focal_length + 0.49) for side in (x, y)
        )
        u = np.rint(x * self._focal_length + 0.5 * (width - 1)).astype(np.int64)
        v = np.rint(y * self._focal_length + 0.5 * (height - 1)).astype(np.int64)
        self._size, self._pixel = (width, height), (height - 1 - v) * width + u
        self._forward, self._up = turn[:, 2], -turn[:, 1]

    def __call__(self, engine: "MujocoEngine") -> NDArray[np.float32]:
        """The present depth image, `[H, W]` [m], along the optical axis; 0 where nothing is in range."""
        model, data = engine.simulation
        depth = self._draw(model, data) if self.method == "opengl" else self._cast(model, data)
        width, height = self.camera.size
        return depth.astype(np.float32).reshape(height, width)

    def _cast(self, model: "mujoco.MjModel", data: "mujoco.MjData") -> NDArray[np.float64]:
        _, distance, _ = _cast(model, data, self._place, self._directions)
        depth = distance / self._lengths
        return np.where((distance > 0) & (depth > _NEAR) & (depth < _FAR), depth, 0.0)

    def _draw(self, model: "mujoco.MjModel", data: "mujoco.MjData") -> NDArray[np.float64]:
        context = _gl_context()
        context.make_current()
        if model is not self._model:  # every episode has its own
            self._load(model)
        option = mujoco.MjvOption()
        free = mujoco.MjvCamera()
        mujoco.mjv_updateScene(
            model, data, option, None, free, mujoco.mjtCatBit.mjCAT_ALL.value, self._scene
        )
        for eye in self._scene.camera:
            self._aim(eye)
        (width, height), buffer = self._size, self._buffer
        area = mujoco.MjrRect(0, 0, width, height)
        mujoco.mjr_render(area, self._scene, self._target)
        mujoco.mjr_readPixels(None, buffer, area, self._target)
        # The buffer holds 0 at the far plane and 1 at the near one.
        nearness = buffer.ravel()[self._pixel].astype(np.float64)
        depth = _NEAR * _FAR / (_NEAR + nearness * (_FAR - _NEAR))
        return np.where((nearness > 0) & (nearness < 1), depth, 0.0)

    def _load(self, model: "mujoco.MjModel") -> None:
        """Upload the shapes of a model."""
        width, height = self._size
        model.vis.quality.offsamples = 0  # else depths are mixed at edges
        model.vis.quality.shadowsize = 0
        model.vis.global_.offwidth, model.vis.global_.offheight = self._size
        self._target = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        self._target.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._target)
        self._scene = mujoco.MjvScene(model, maxgeom=1000)
        self._scene.flags[:] = 0
        self._scene.flags[mujoco.mjtRndFlag.mjRND_SEGMENT] = 1  # colours without light
        self._buffer = np.empty((height, width), np.float32)
        self._model = model

    def _aim(self, eye: "mujoco.MjvGLCamera") -> None:
        width, height = self._size
        eye.pos, eye.forward, eye.up = self._place, self._forward, self._up
        eye.frustum_near, eye.frustum_far, eye.frustum_center = _NEAR, _FAR, 0.0
        eye.frustum_top = 0.5 * height / self._focal_length * _NEAR
        eye.frustum_bottom = -eye.frustum_top
        eye.frustum_width = 0.5 * width / self._focal_length * _NEAR


@functools.cache  # one for all renderers of a process, since each costs a second
def _gl_context() -> Any:
    """A context of OpenGL that needs no display; None if there is none."""
    for name in _BACKENDS:
        # Whatever is missing, from the library to the driver, says so in another way.
        with suppress(Exception):
            return importlib.import_module(name).GLContext(64, 64)
    return None


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
    """The present picture from the side, `[H, W, 3]`, with a disc at the goal (x, y) [m]."""
    rays, eye = _rays(), np.array(_EYE)
    geoms, distance, normals = _cast(model, data, eye, rays)
    hit = geoms >= 0
    points = eye + np.where(hit, distance, _FARTHEST)[:, None] * rays
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
    """First hits of rays from one point: geoms (-1: none), distance [m] and surface's normal."""
    n, farthest = len(rays), _FARTHEST
    geoms, distance, normals = np.empty(n, np.int32), np.empty(n), np.zeros(3 * n)
    mujoco.mj_multiRay(
        model, data, start, rays.ravel(), None, True, -1, geoms, distance, normals, n, farthest
    )
    return geoms, distance, normals.reshape(n, 3)
