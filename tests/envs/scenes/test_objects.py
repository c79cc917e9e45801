import dataclasses
import math

import cv2
import numpy as np
import pytest

from modpush.agents import ScriptedPusher
from modpush.envs import PushedObject, PushEnv, ScenarioConfig
from modpush.envs.scenes.objects import OBJECTS, SUPPORT_DIRECTIONS, get_object, random_object
from modpush.geometry import box, centered, cylinder

CUBE = box(0.05, 0.05, 0.05)
L_SHAPE = PushedObject(
    name="l_shape", parts=centered(box(0.10, 0.03, 0.04), box(0.03, 0.07, 0.04, (0.035, 0.05, 0.0)))
)


@pytest.mark.parametrize(
    ("name", "radius", "height", "symmetry"),
    [
        ("small_cube", "0x1.21a1851ff630ap-5", 0.05, 4),
        ("large_cube", "0x1.826a764552802p-5", 0.05, 2),
        ("small_cylinder", "0x1.eb851eb851eb8p-6", 0.06, 0),
        ("fragment", "0x1.84d8159dd8574p-5", 0.029, 1),
    ],
)
def test_computed_values_are_those_that_agents_were_trained_with(name, radius, height, symmetry):
    item = OBJECTS[name]
    assert item.radius == float.fromhex(radius)
    assert (item.height, item.symmetry) == (height, symmetry)


def test_a_smaller_symmetry_may_be_given() -> None:
    assert [PushedObject(name="a", parts=(CUBE,), symmetry=n).symmetry for n in (1, 2, 4)] == [
        1,
        2,
        4,
    ]
    can = cylinder(0.03, 0.06)
    assert [PushedObject(name="a", parts=(can,), symmetry=n).symmetry for n in (0, 7)] == [0, 7]


def test_footprints_lie_where_the_parts_do() -> None:
    first, second = L_SHAPE.footprints()
    assert second.mean(0) - first.mean(0) == pytest.approx([0.035, 0.05])


def test_an_object_found_by_text_is_called_so() -> None:
    name = f"{__name__}:L_SHAPE"
    found = get_object(name)
    assert found.name == name
    assert dataclasses.replace(found, name="l_shape") == L_SHAPE
    assert ScenarioConfig(pushed_object=name).objects == [found]
    assert get_object("l_shape", {"l_shape": L_SHAPE}) is L_SHAPE


def test_sizes_are_those_of_the_paper() -> None:
    assert OBJECTS["small_cube"].parts[0].size == (0.025, 0.025, 0.025)
    assert OBJECTS["large_cube"].parts[0].size == (0.04, 0.025, 0.025)
    assert OBJECTS["small_cylinder"].parts[0].size[:2] == (0.03, 0.03)
    outline = np.vstack(OBJECTS["fragment"].footprints())
    assert np.ptp(outline, axis=0) == pytest.approx([0.082, 0.085])
    assert OBJECTS["fragment"].height == pytest.approx(0.029)


def test_fragment_is_made_of_convex_parts_around_its_centroid() -> None:
    mask = np.zeros((2000, 2000), np.uint8)
    for outline in OBJECTS["fragment"].footprints():
        pixels = np.round(outline * 1e4 + 1000).astype(np.int32)
        assert cv2.isContourConvex(pixels)
        cv2.fillPoly(mask, [pixels], 1)
    centroid = (np.argwhere(mask)[:, ::-1].mean(0) - 1000) / 1e4
    assert centroid == pytest.approx([0, 0], abs=2e-4)


@pytest.mark.parametrize("name", sorted(OBJECTS))
def test_radius_is_that_of_the_circumscribed_circle(name) -> None:
    item = OBJECTS[name]
    corners = np.vstack(item.footprints())
    assert np.linalg.norm(corners, axis=1).max() == pytest.approx(item.radius)


def test_random_objects_are_of_all_kinds_and_of_sizes_that_can_be_pushed():
    items = [random_object(seed) for seed in range(300)]
    kinds = [item.parts[0].kind for item in items]
    assert all(kinds.count(kind) > 60 for kind in ("box", "cylinder", "prism"))
    for seed, item in enumerate(items):
        assert item.name == f"random_{seed}"
        assert 0.019 < item.radius < 0.06
        assert item.inscribed_radius > 0.007
        assert 0.03 <= item.height <= 0.07


def test_a_random_object_is_found_by_its_name_and_is_always_the_same():
    assert get_object("random_7") == random_object(7) != random_object(8)
    own = dataclasses.replace(OBJECTS["small_cube"], name="random_7")
    assert get_object("random_7", {"random_7": own}) is own
    with pytest.raises(ValueError, match="pushed_object"):
        get_object("random_x")


@pytest.mark.parametrize("item", [*OBJECTS.values(), L_SHAPE, *map(random_object, range(6))])
def test_the_support_is_the_farthest_point_in_each_direction(item):
    angles = 2 * np.pi * np.arange(SUPPORT_DIRECTIONS) / SUPPORT_DIRECTIONS
    points = np.concatenate(item.footprints(720))
    for angle, reach in zip(angles, item.support, strict=True):
        expected = max(x * math.cos(angle) + y * math.sin(angle) for x, y in points)
        assert reach == pytest.approx(expected, abs=2e-5)
    assert item.support.max() <= item.radius + 1e-9


def test_random_objects_rest_on_the_table_and_can_be_pushed():
    names = [f"random_{seed}" for seed in range(8)]
    env = PushEnv(8, pushed_object=names, depth=None, seed=0, max_episode_steps=120)
    td = env.reset()
    rollout = env.rollout(
        120, policy=ScriptedPusher(), auto_reset=False, tensordict=td, break_when_any_done=False
    )
    assert len({scenario.pushed_object for scenario in env.scenarios}) >= 3
    assert rollout["next", "success"].any(1).float().mean() >= 0.75
    env.close()
