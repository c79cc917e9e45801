"""`DepthRenderer`: depth images of a scene in MuJoCo, from a camera of any pose."""

import importlib
import math
from contextlib import suppress
from typing import Any, Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from modpush._validation import checked_arguments
from modpush.envs.engines.mujoco.engine import MujocoEngine
from modpush.geometry.camera_model import CameraModel

_NEAR, _FAR = 0.05, 5.0
"""Range of depth [m]; a pixel beyond it has no reading."""
_BACKENDS = ("mujoco.egl", "mujoco.osmesa")
_contexts: list[
    Any
] = []  # of OpenGL in this process: one for all renderers, since each costs a second


class DepthRenderer:
    """Renders the depth image that a calibrated camera has of a scene, arm included.

    MuJoCo's own renderer draws it where OpenGL can be had without a display (EGL or OSMesa; Debian's
    `libegl1` with Mesa draws on the CPU). Everywhere else, rays are cast, in four times the time.

    Args:
        camera: The camera. Where it has distortion, the image has it, too.
        method: `"opengl"`, `"rays"`, or `"auto"` for the first one if it can be had.

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
        self._directions = (self._rays / self._lengths[:, None]).ravel()
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

    def __call__(self, engine: MujocoEngine) -> NDArray[np.float32]:
        """The present depth image, `[H, W]` [m], along the optical axis; 0 where nothing is in range."""
        model, data = engine.simulation
        depth = self._draw(model, data) if self.method == "opengl" else self._cast(model, data)
        width, height = self.camera.size
        return depth.astype(np.float32).reshape(height, width)

    def _cast(self, model: "mujoco.MjModel", data: "mujoco.MjData") -> NDArray[np.float64]:
        count = len(self._rays)
        geoms, distance = np.empty(count, np.int32), np.empty(count)
        mujoco.mj_multiRay(
            model,
            data,
            self._place,
            self._directions,
            None,
            True,
            -1,
            geoms,
            distance,
            None,
            count,
            1e3,
        )
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


def _gl_context() -> Any:
    """A context of OpenGL that needs no display; None if there is none."""
    if not _contexts:
        for name in _BACKENDS:
            # Whatever is missing, from the library to the driver, says so in another way.
            with suppress(Exception):
                _contexts.append(importlib.import_module(name).GLContext(64, 64))
                break
        else:
            _contexts.append(None)
    return _contexts[0]
