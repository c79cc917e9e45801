"""The colour picture of a scene in MuJoCo, against the shapes that it must show."""

import numpy as np
import pytest
import torch

from modpush.envs import PushEnv, Scenario
from modpush.geometry import CameraModel

CAMERA = CameraModel.looking_at((0.40, 0.0, 0.05), (1.35, 0.75, 0.85), (512, 512), 650.2)


@pytest.fixture(scope="module")
def env():
    env = PushEnv(1, engine="mujoco", depth=None, pictures=True, pushed_object="small_cube")
    cube = Scenario(
        scene="free",
        difficulty=0.0,
        obstacles=(),
        object_pose=(0.6, 0.1, 0.0),
        goal_position=(0.6, -0.2),
        tool_pose=(0.45, 0.25, 0.0),
        pushed_object="small_cube",
    )
    env.reset(scenarios=[cube])
    yield env
    env.close()


def color_at(picture: np.ndarray, point: tuple[float, float, float]) -> np.ndarray:
    """Mean red, green and blue of the 5 x 5 pixels around where a point is seen, in [0, 1]."""
    to_camera = np.linalg.inv(CAMERA.camera_in_base)
    x, y, z = (to_camera @ [*point, 1.0])[:3]
    u, v = (round(650.2 * side / z + 255.5) for side in (x, y))
    return picture[v - 2 : v + 3, u - 2 : u + 3].mean((0, 1)) / 255


def test_object_goal_and_table_are_seen_where_they_are(env) -> None:
    picture = env.render()
    assert (picture.shape, picture.dtype) == ((512, 512, 3), np.uint8)
    red, green, blue = color_at(picture, (0.6, 0.1, 0.05))  # the cube's top
    assert red > 3 * max(green, blue)
    red, green, blue = color_at(picture, (0.6, -0.2, 0.0))
    assert green > 3 * max(red, blue)
    table = color_at(picture, (0.75, 0.2, 0.0))
    assert np.ptp(table) < 0.1
    assert table.min() > 0.6


def test_the_arm_casts_a_shadow(env) -> None:
    ambient = 0.45 * 255 * np.array([0.93, 0.91, 0.87])  # of the table, where the light is not seen
    assert 1000 < (np.abs(env.render() - ambient) < 1).all(-1).sum() < 50_000


def test_the_picture_follows_the_arm(env) -> None:
    before = env.render()
    td = env.reset(scenarios=env.scenarios)
    for _ in range(3):
        td = env.step(td.set("action", -torch.ones(1, 3)))["next"]
    changed = np.abs(env.render().astype(int) - before).max(-1) > 20
    assert 0.001 < changed.mean() < 0.2
