import math
from collections.abc import Iterator

import numpy as np
import pytest
import torch

from modpush.envs import OBJECTS, SCENES, PushEnv
from modpush.envs.depth.analytic import AnalyticDepthCamera
from modpush.envs.depth.raycast import Solids, blank_image, draw
from modpush.geometry.camera import CAMERA, Label
from modpush.geometry.shapes import box, capsule, cylinder, prism

UPRIGHT = [1.0, 0.0, 0.0, 0.0]


def image_of(part, position, quaternion=UPRIGHT):
    depth, segmentation = blank_image()
    pose = np.array([[*position, *quaternion]])
    draw(depth, segmentation, Solids.of([part]), pose, Label.OBJECT)
    return depth, segmentation


def test_bare_table_is_flat() -> None:
    depth, segmentation = blank_image()
    assert (depth == np.float32(1.1)).all()
    assert not segmentation.any()


def test_a_cube_by_hand() -> None:
    # Under the camera; its top, 5 cm up, is 5 cm * f / 1.05 = 14.7 px wide.
    depth, segmentation = image_of(box(0.05, 0.05, 0.05), (0.60, 0.0, 0.025))
    assert depth[127, 127] == pytest.approx(1.05, abs=1e-6)
    assert (segmentation == Label.OBJECT).sum() == 14 * 14
    assert depth[127, 110] == pytest.approx(1.1, abs=1e-6)


@pytest.mark.parametrize(
    ("part", "height"),
    [
        (cylinder(0.03, 0.06), 0.06),
        (capsule(0.03, 0.06), 0.12),
        (prism(((0.03, 0), (0, 0.03), (-0.03, 0), (0, -0.03)), 0.02), 0.02),
    ],
)
def test_tops_of_other_solids(part, height) -> None:
    depth, segmentation = image_of(part, (0.60, 0.0, height / 2))
    # The four middle pixels look 2.5 mm off the axis, where a ball is 0.1 mm lower.
    assert depth[127, 127] == pytest.approx(1.1 - height, abs=2e-4)
    assert segmentation[127, 127] == Label.OBJECT


def test_footprints_have_the_right_area() -> None:
    pixel = (1.1 - 0.001) / CAMERA.focal_length
    for part, area in (
        (cylinder(0.15, 0.001), math.pi * 0.15**2),
        (prism(((0.15, 0), (0, 0.15), (-0.15, 0), (0, -0.15)), 0.001), 2 * 0.15**2),
    ):
        _, segmentation = image_of(part, (0.61, 0.003, 0.0005))
        assert segmentation.sum() * pixel**2 == pytest.approx(area, rel=0.01)


def test_turned_and_moved_solids_look_the_same() -> None:
    # A quarter turn of a square prism about any axis leaves a cube a cube.
    cube = box(0.06, 0.06, 0.06)
    plain, _ = image_of(cube, (0.5, 0.1, 0.03))
    for axis in range(3):
        quaternion = [math.sqrt(0.5), 0.0, 0.0, 0.0]
        quaternion[1 + axis] = math.sqrt(0.5)
        turned, _ = image_of(cube, (0.5, 0.1, 0.03), quaternion)
        np.testing.assert_allclose(turned, plain, atol=1e-6)


@pytest.fixture(scope="module")
def env() -> Iterator[PushEnv]:
    env = PushEnv(1, scene=tuple(SCENES), pushed_object=tuple(OBJECTS), depth=None)
    yield env
    env.close()


def test_images_equal_physx_own_ray_casts(env) -> None:
    """PhysX's scene query sees the very shapes that collide, the robot's included."""
    camera = AnalyticDepthCamera(env._batch, arm_in_depth=True)
    (engine,) = env._batch.engines
    rng = np.random.default_rng(1)
    origin = np.array(CAMERA.position, dtype=np.float32)
    compared = differing = 0
    for seed in range(20):
        td = env.reset(seed=seed)
        for _ in range(1 + seed % 4):  # a scene query sees the arm where the last step left it
            action = torch.from_numpy(rng.uniform(-1, 1, (1, 3)).astype(np.float32))
            td = env.step(td.set("action", action))["next"]
        camera.reset(0)
        depth, segmentation = blank_image()
        camera.capture(0, depth, segmentation)
        on_something = np.argwhere(segmentation > 0)
        picked = on_something[rng.permutation(len(on_something))[:150]]
        for v, u in [*picked, *rng.integers(0, 256, (50, 2))]:
            way = np.append(CAMERA.unproject(np.array([u, v], float)), 0.0) - origin
            direction = (way / np.linalg.norm(way)).astype(np.float32)
            hit = engine.task.scene.px.raycast(origin, direction, 3.0)
            compared += 1
            differing += abs((1.1 - hit.position[2]) - depth[v, u]) > 1e-3
    assert compared == 20 * 200
    # PhysX's cylinders are prisms of many sides, so rims differ, and edges are a rounding's choice.
    assert differing / compared < 0.01
