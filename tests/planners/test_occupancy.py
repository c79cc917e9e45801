"""Depth to occupancy: geometry, inflation, memory, bad input."""

import copy
import math
import pickle

import cv2
import numpy as np
import pytest
import scipy.ndimage as ndi
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from modpush.geometry import SEGMENT_OBJECT, SEGMENT_OBSTACLE, SEGMENT_ROBOT, GridFrame
from modpush.planners import OccupancyMap, circumscribed_radius, inflate
from tests.planners.planner_reference import random_map
from tests.planners.table_scene import BAR, render, square

FRAME = GridFrame()


def as_tensors(*images):
    return [torch.from_numpy(image)[None] for image in images]


def standing(boxes, frame=FRAME):
    """The cells whose centre lies under one of the boxes, `[H, W]` bool."""
    grid = torch.meshgrid(torch.arange(frame.width), torch.arange(frame.height), indexing="xy")
    position = frame.to_metre(torch.stack(grid, -1).double())
    x, y = position[..., 0].numpy(), position[..., 1].numpy()
    return np.any([(x >= b[0]) & (x <= b[1]) & (y >= b[2]) & (y <= b[3]) for b in boxes], axis=0)


def assert_right_to_a_cell(blocked, truth):
    assert (ndi.binary_erosion(truth, np.ones((3, 3))) <= blocked).all()
    assert (blocked <= ndi.binary_dilation(truth, np.ones((3, 3)))).all()


def test_pixels_by_hand():
    # f = 128 / tan(22.5 deg) = 309.019 px; 1.1 m / f = 3.5596 mm a cell.
    assert FRAME.focal_length == pytest.approx(309.0193, abs=1e-4)
    assert FRAME.cell_size == pytest.approx(0.00355965, abs=1e-8)
    position = torch.tensor([[0.60, 0.0], [0.70, 0.0], [0.60, 0.10]], dtype=torch.float64)
    # 0.1 m on the table are 28.0927 px: away from the robot is up, the robot's left is left.
    expected = torch.tensor([[127.5, 127.5], [127.5, 127.5 - 28.09266], [127.5 - 28.09266, 127.5]])
    torch.testing.assert_close(FRAME.to_pixel(position), expected.double(), atol=1e-4, rtol=0)
    # At height 0.06 the same 0.1 m are seen 1.1 / 1.04 times as large.
    at_top = FRAME.to_pixel(position[1:2], 0.06)
    assert at_top[0, 1].item() == pytest.approx(127.5 - 28.09266 * 1.1 / 1.04, abs=1e-3)


@settings(max_examples=50, deadline=None)
@given(
    st.floats(-2, 2), st.floats(-2, 2), st.floats(0, 0.5), st.integers(1, 500), st.integers(1, 500)
)
def test_there_and_back_between_pixels_and_metres(x, y, z, height, width):
    frame = GridFrame(height=height, width=width, camera_x=0.3, camera_y=-0.2)
    position = torch.tensor([x, y], dtype=torch.float64)
    again = frame.to_metre(frame.to_pixel(position, z), z)
    torch.testing.assert_close(again, position, atol=1e-9, rtol=1e-9)


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"height": 0}, "height and width must be >= 1, got 0 and 256"),
        ({"camera_z": 0.0}, "camera_z must be > 0, got 0.0"),
        ({"field_of_view": 3.5}, r"field_of_view must lie in \(0, pi\), got 3.5"),
    ],
)
def test_bad_frames_are_refused(kwargs, message):
    with pytest.raises(ValueError, match=message):
        GridFrame(**kwargs)


@pytest.mark.parametrize("radius", [0, 0.5, 1, 1.41, 1.42, 2, 3.7, 9.93, 10, 16.2])
def test_inflation_is_the_exact_euclidean_one(radius):
    blocked = random_map(np.random.default_rng(2), radius=0)
    expected = ndi.distance_transform_edt(~blocked) <= radius + 1e-9
    assert (inflate(*as_tensors(blocked), radius)[0].numpy() == expected).all()


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_inflation_on_all_sizes_and_radii(seed):
    rng = np.random.default_rng(seed)
    blocked = rng.random(rng.integers(1, 140, 2)) < rng.choice([0.0, 0.001, 0.02, 0.3])
    radius = float(rng.uniform(0, 25))
    out = inflate(*as_tensors(blocked), radius)[0].numpy()
    if blocked.any():
        assert (out == (ndi.distance_transform_edt(~blocked) <= radius + 1e-9)).all()
    else:
        assert not out.any()


def test_inflation_equals_opencv_s_dilation_by_a_disc():
    blocked = random_map(np.random.default_rng(4), radius=0)
    disc = (np.hypot(*np.mgrid[-10:11, -10:11]) <= 10).astype(np.uint8)
    expected = cv2.dilate(blocked.astype(np.uint8), disc).astype(bool)
    assert (inflate(*as_tensors(blocked), 10.0)[0].numpy() == expected).all()


def test_inflation_takes_a_radius_for_each_scene():
    blocked = torch.zeros(3, 9, 9, dtype=torch.bool)
    blocked[:, 4, 4] = True
    out = inflate(blocked, torch.tensor([0.0, 1.0, 1.5]))
    assert out.sum((1, 2)).tolist() == [1, 5, 9]


@pytest.mark.parametrize(
    ("blocked", "radius", "error", "message"),
    [
        (torch.zeros(1, 4, 4), 1.0, TypeError, "blocked must be bool, got torch.float32"),
        (
            torch.zeros(4, 4, dtype=torch.bool),
            1.0,
            ValueError,
            r"must be \[B, H, W\], got \[4, 4\]",
        ),
        (torch.zeros(1, 4, 4, dtype=torch.bool), -1.0, ValueError, "finite and >= 0, got"),
        (torch.zeros(1, 4, 4, dtype=torch.bool), math.inf, ValueError, "finite and >= 0, got"),
        (
            torch.zeros(1, 4, 4, dtype=torch.bool),
            torch.ones(3),
            ValueError,
            r"one number or \[B\] = \[1\], got \[3\]",
        ),
    ],
)
def test_inflate_refuses_bad_input(blocked, radius, error, message):
    with pytest.raises(error, match=message):
        inflate(blocked, radius)


def test_obstacles_are_drawn_where_they_stand():
    bars = [(0.80, 0.86, -0.3, 0.2, 0.06), (0.30, 0.36, 0.10, 0.40, 0.06)]
    depth, segments = as_tensors(*render([(bar, SEGMENT_OBSTACLE) for bar in bars], FRAME))
    truth = standing(bars)
    upright = OccupancyMap()(depth, 0.0, segments)[0][0].numpy()
    as_seen = OccupancyMap(upright=False)(depth, 0.0, segments)[0][0].numpy()
    # Upright is right to a cell at the rim; as seen, the tops lean out by up to 6.6 px.
    assert_right_to_a_cell(upright, truth)
    assert (upright != truth).sum() < 60
    assert (as_seen != truth).sum() > 1000


def test_object_and_robot_do_not_block_and_low_things_do_not_either():
    things = [
        (BAR, SEGMENT_OBSTACLE),
        (square(0.7, 0.1), SEGMENT_OBJECT),
        (square(0.7, -0.1, height=0.3), SEGMENT_ROBOT),
        (square(0.4, 0.3, height=0.012), SEGMENT_OBSTACLE),
        (square(0.4, -0.3, height=0.014), SEGMENT_OBSTACLE),
    ]
    depth, segments = as_tensors(*render(things, FRAME))
    blocked = OccupancyMap()(depth, 0.0, segments)[0][0].numpy()
    assert_right_to_a_cell(blocked, standing([BAR, square(0.4, -0.3)]))
    assert not blocked[standing([square(0.7, 0.1), square(0.7, -0.1), square(0.4, 0.3)])].any()


def test_without_a_segmentation_the_object_is_what_stands_around_its_pose():
    things = [(BAR, SEGMENT_OBSTACLE), (square(0.7, 0.1), SEGMENT_OBJECT)]
    depth, _ = as_tensors(*render(things, FRAME))
    position, radius = torch.tensor([[0.7, 0.1]]), 0.0354
    with_pose = OccupancyMap()(depth, radius, None, position)[0][0].numpy()
    alone, _ = as_tensors(*render(things[:1], FRAME))
    assert (with_pose == OccupancyMap()(alone, radius)[0][0].numpy()).all()
    assert OccupancyMap()(depth, radius)[0][0].numpy()[standing([square(0.7, 0.1)])].all()


def test_pixels_that_saw_nothing_are_free():
    depth = torch.full((1, 256, 256), 1.1)
    depth[0, 10, 10], depth[0, 20, 20], depth[0, 30, 30], depth[0, 40, 40] = (
        0.0,
        -1.0,
        math.nan,
        math.inf,
    )
    assert not OccupancyMap()(depth, 0.05)[0].any()


def test_what_the_object_hides_is_remembered():
    # A 2 cm obstacle outside of the object, seen from the camera, disappears behind it.
    low = (0.755, 0.765, -0.01, 0.01, 0.02)
    before = render([(low, SEGMENT_OBSTACLE)], FRAME)
    after = render(
        [(low, SEGMENT_OBSTACLE), (square(0.725, 0.0, height=0.06), SEGMENT_OBJECT)], FRAME
    )
    blocked = OccupancyMap()
    free_view, bits = blocked(as_tensors(before[0])[0], 0.0, as_tensors(before[1])[0])
    depth, segments = as_tensors(*after)
    forgotten, _ = blocked(depth, 0.0, segments)
    remembered, bits_after = blocked(depth, 0.0, segments, previous=bits)
    assert forgotten.sum() < free_view.sum()
    assert torch.equal(remembered, free_view)
    assert torch.equal(bits_after, bits)
    gone, segments = as_tensors(*render([], FRAME))
    assert not blocked(gone, 0.0, segments, previous=bits)[0].any()  # seen to be gone


def test_nothing_is_inflated_again_while_obstacles_stand_still():
    blocked, bits = OccupancyMap(), None
    for k in range(12):
        position = 0.35 + 0.02 * k, 0.25 - 0.005 * k
        depth, segments = as_tensors(
            *render([(BAR, SEGMENT_OBSTACLE), (square(*position), SEGMENT_OBJECT)], FRAME)
        )
        occupancy, bits = blocked(depth, 0.0354, segments, previous=bits)
    assert blocked.inflations == 1
    occupancy_again, _ = blocked(depth, 0.05, segments, previous=bits)  # another object
    assert blocked.inflations == 2
    assert occupancy_again.sum() > occupancy.sum()


def test_the_given_out_grid_is_not_written_to_again():
    depth, segments = as_tensors(*render([(BAR, SEGMENT_OBSTACLE)], FRAME))
    blocked = OccupancyMap()
    first, _ = blocked(depth, 0.03, segments)
    kept = first.clone()
    blocked(torch.full_like(depth, 1.1), 0.03, torch.zeros_like(segments))
    assert torch.equal(first, kept)


def test_copies_and_pickles_see_alike():
    depth, segments = as_tensors(*render([(BAR, SEGMENT_OBSTACLE)], FRAME))
    blocked = OccupancyMap()
    expected = blocked(depth, 0.03, segments)[0]
    for other in (copy.deepcopy(blocked), pickle.loads(pickle.dumps(blocked))):
        assert torch.equal(other(depth, 0.03, segments)[0], expected)


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ((torch.ones(1, 256, 256).double(), 0.03), TypeError, "depth must be float32 metres"),
        ((torch.ones(1, 64, 64), 0.03), ValueError, r"depth must be \[B, H, W\] = \[1, 256, 256\]"),
        (
            (torch.ones(1, 256, 256), 0.03, torch.ones(1, 256, 256)),
            TypeError,
            "segmentation must be uint8, got torch.float32",
        ),
        (
            (torch.ones(1, 256, 256), 0.03, torch.ones(1, 4, 4, dtype=torch.uint8)),
            ValueError,
            r"segmentation must be \[B, H, W\] = \[1, 256, 256\], got \[1, 4, 4\]",
        ),
        (
            (torch.ones(1, 256, 256), 0.03, None, torch.ones(2, 2)),
            ValueError,
            r"object_position must be \[B, 2\] = \[1, 2\], got \[2, 2\]",
        ),
        ((torch.ones(1, 256, 256), -0.1), ValueError, "radius must be finite and >= 0"),
    ],
)
def test_bad_images_are_refused(arguments, error, message):
    with pytest.raises(error, match=message):
        OccupancyMap()(*arguments)


def test_min_height_must_lie_under_the_camera():
    with pytest.raises(ValueError, match="min_height must lie between 0 and the camera's height"):
        OccupancyMap(min_height=1.2)


def test_circumscribed_radius_of_the_large_cube():
    corners = torch.tensor([[0.04, 0.025], [-0.04, 0.025], [-0.04, -0.025], [0.04, -0.025]])
    assert circumscribed_radius(corners) == pytest.approx(0.0471699, abs=1e-6)
