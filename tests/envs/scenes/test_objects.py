import cv2
import numpy as np
import pytest

from modpush.envs.scenes.objects import OBJECTS, get_object


def test_sizes_are_those_of_the_spec() -> None:
    assert OBJECTS["small_cube"].parts[0].size == (0.025, 0.025, 0.025)
    assert OBJECTS["large_cube"].parts[0].size == (0.04, 0.025, 0.025)
    assert OBJECTS["small_cylinder"].parts[0].size[:2] == (0.03, 0.03)
    outline = np.vstack(OBJECTS["fragment"].footprints())
    assert np.ptp(outline, axis=0) == pytest.approx([0.082, 0.085])
    assert OBJECTS["fragment"].height == pytest.approx(0.029)


def test_all_weigh_the_same_and_none_meets_the_grippers_linkage() -> None:
    assert {item.mass for item in OBJECTS.values()} == {1.0}
    assert max(item.height for item in OBJECTS.values()) <= 0.06


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


def test_an_unknown_object_is_answered_with_the_list() -> None:
    with pytest.raises(
        ValueError, match=r"there is no 'ball', expected one of \['fragment', 'large"
    ):
        get_object("ball")
