"""Depth from MuJoCo: by both methods, and against the camera that computes it from the shapes."""

import numpy as np
import pytest

from modpush.envs import PushEnv
from modpush.envs.engines.mujoco import rendering
from modpush.envs.engines.mujoco.engine import MujocoEngine
from modpush.envs.engines.mujoco.rendering import DepthRenderer
from modpush.geometry import CAMERA, CameraModel

TILTED = CameraModel.looking_at(
    (0.5, 0.0, 0.0), (1.0, 0.1, 0.85), size=(320, 240), focal_length=260.0
)
BENT = CameraModel.looking_at(
    (0.5, 0.0, 0.0), (1.0, 0.1, 0.85), (320, 240), 260.0, distortion=(0.1, -0.05, 0.001, 0.002)
)


@pytest.fixture(scope="module")
def env():
    env = PushEnv(
        1, scene="slot", pushed_object="fragment", engine="mujoco", seed=0, arm_in_depth=True
    )
    env.reset()
    yield env
    env.close()


def engine_of(env: PushEnv) -> MujocoEngine:
    (engine,) = env._batch.engines
    return engine


def test_rays_see_what_the_policy_s_camera_sees(env) -> None:
    straight = CameraModel.looking_at(
        (CAMERA.x, CAMERA.y, 0.0),
        CAMERA.position,
        (CAMERA.width, CAMERA.height),
        CAMERA.focal_length,
        up=(1.0, 0.0, 0.0),
    )
    seen = DepthRenderer(straight, "rays")(engine_of(env))
    expected = env.reset()["depth"][0, 0].numpy()
    seen = DepthRenderer(straight, "rays")(engine_of(env))
    assert (np.abs(seen - expected) > 1e-3).mean() < 0.001  # at edges


def test_what_is_out_of_range_has_no_reading(env) -> None:
    level = CameraModel.looking_at((2.0, 0.0, 0.5), (1.5, 0.0, 0.5), (64, 48), 50.0)
    depth = DepthRenderer(level, "rays")(engine_of(env))
    assert (depth[:24] == 0.0).all()  # the sky
    assert (depth[-5:] > 0.5).all()  # the table


@pytest.mark.parametrize("camera", [TILTED, BENT], ids=["plain", "distorted"])
def test_opengl_and_rays_give_one_image(env, camera) -> None:
    if rendering._gl_context() is None:
        pytest.skip("no OpenGL without a display here")
    draw, cast = DepthRenderer(camera, "opengl"), DepthRenderer(camera, "rays")
    for _ in range(2):  # each episode has a model of its own
        env.reset()
        drawn, seen = draw(engine_of(env)), cast(engine_of(env))
        apart = np.abs(drawn - seen)
        # Half a pixel of a table that recedes, where distortion leaves pixels between others.
        assert np.median(apart) < (1e-5 if camera is TILTED else 1e-3)
        assert (apart > 5e-3).mean() < 0.01


def test_without_opengl_rays_are_cast(env, monkeypatch) -> None:
    monkeypatch.setattr(rendering, "_gl_context", lambda: None)
    assert DepthRenderer(TILTED).method == "rays"
    with pytest.raises(RuntimeError, match="EGL or OSMesa"):
        DepthRenderer(TILTED, "opengl")
