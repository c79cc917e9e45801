import numpy as np
import pytest
import torch
from hypothesis import given, settings, strategies as st

from modpush.geometry import CAMERA, Camera


def test_the_image_shows_as_much_of_the_table_as_the_authors_camera():
    assert CAMERA.focal_length == pytest.approx(309.02, abs=0.005)
    assert CAMERA.cell_size == pytest.approx(3.56e-3, abs=5e-6)
    left, right = CAMERA.unproject(torch.tensor([[-0.5, 127.5], [255.5, 127.5]]))
    assert left[1] - right[1] == pytest.approx(0.911, abs=5e-4)


def test_up_in_the_image_is_away_from_the_robot_and_left_is_left():
    assert CAMERA.unproject(torch.tensor([127.5, 0.0]))[0] > 0.60
    assert CAMERA.unproject(torch.tensor([0.0, 127.5]))[1] > 0.0


def test_pixels_by_hand():
    # f = 128 / tan(22.5 deg) = 309.019 px; 1.1 m / f = 3.5596 mm a cell.
    assert CAMERA.focal_length == pytest.approx(309.0193, abs=1e-4)
    assert CAMERA.cell_size == pytest.approx(0.00355965, abs=1e-8)
    position = torch.tensor([[0.60, 0.0], [0.70, 0.0], [0.60, 0.10]], dtype=torch.float64)
    # 0.1 m on the table are 28.0927 px: away from the robot is up, the robot's left is left.
    expected = torch.tensor([[127.5, 127.5], [127.5, 127.5 - 28.09266], [127.5 - 28.09266, 127.5]])
    torch.testing.assert_close(CAMERA.project(position), expected.double(), atol=1e-4, rtol=0)
    # At height 0.06 the same 0.1 m are seen 1.1 / 1.04 times as large.
    at_top = CAMERA.project(position[1:2], 0.06)
    assert at_top[0, 1].item() == pytest.approx(127.5 - 28.09266 * 1.1 / 1.04, abs=1e-3)


@settings(max_examples=50, deadline=None)
@given(
    st.floats(-2, 2), st.floats(-2, 2), st.floats(0, 0.5), st.integers(1, 500), st.integers(1, 500)
)
def test_there_and_back_between_pixels_and_metres(x, y, z, height, width):
    camera = Camera(height=height, width=width, x=0.3, y=-0.2)
    position = torch.tensor([x, y], dtype=torch.float64)
    again = camera.unproject(camera.project(position, z), z)
    torch.testing.assert_close(again, position, atol=1e-9, rtol=1e-9)


@pytest.mark.parametrize("method", [CAMERA.project, CAMERA.unproject])
def test_arrays_and_tensors_give_the_same_bits(method):
    points = np.random.default_rng(0).uniform(-1, 1, (50, 2))
    array = method(points, 0.06)
    assert isinstance(array, np.ndarray)
    np.testing.assert_array_equal(array, method(torch.from_numpy(points), 0.06).numpy())


@pytest.mark.parametrize("method", [CAMERA.project, CAMERA.unproject])
def test_each_point_may_have_its_own_height(method):
    rng = np.random.default_rng(0)
    points, heights = rng.uniform(-1, 1, (50, 2)), rng.uniform(0, 0.2, 50)
    one_by_one = [method(point, z) for point, z in zip(points, heights.tolist(), strict=True)]
    np.testing.assert_array_equal(method(points, heights), one_by_one)
    tensor = method(torch.from_numpy(points), torch.from_numpy(heights))
    np.testing.assert_allclose(tensor.numpy(), one_by_one, rtol=1e-14)
