"""Depth to occupancy: geometry, inflation, memory, bad input."""

import math

import numpy as np
import pytest
import scipy.ndimage as ndi
import torch
from box_images import BAR, render, square
from hypothesis import given, settings, strategies as st
from planner_maps import random_map

from modpush.geometry import CAMERA, Label
from modpush.planners import OccupancyMap, inflate


def as_tensors(*images):
    return [torch.from_numpy(image)[None] for image in images]


def standing(boxes, camera=CAMERA):
    """The cells whose centre lies under one of the boxes, `[H, W]` bool."""
    grid = torch.meshgrid(torch.arange(camera.width), torch.arange(camera.height), indexing="xy")
    position = camera.unproject(torch.stack(grid, -1).double())
    x, y = position[..., 0].numpy(), position[..., 1].numpy()
    return np.any([(x >= b[0]) & (x <= b[1]) & (y >= b[2]) & (y <= b[3]) for b in boxes], axis=0)


def assert_right_to_a_cell(blocked, truth):
    assert (ndi.binary_erosion(truth, np.ones((3, 3))) <= blocked).all()
    assert (blocked <= ndi.binary_dilation(truth, np.ones((3, 3)))).all()


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


def test_groups_of_few_pixels_are_taken_for_noise():
    depth = torch.full((2, CAMERA.height, CAMERA.width), CAMERA.z)
    depth[:, 100, 100] = 0.9  # a flying pixel
    depth[1, 50, 50] = depth[1, 51, 51] = depth[1, 50, 52] = 0.9  # three that touch at corners
    depth[:, 200:204, 30:34] = 1.0
    before = depth.clone()
    exact, _ = OccupancyMap(upright=False)(depth, 0.0)
    assert exact.sum((1, 2)).tolist() == [17, 20]
    for min_pixels, left in ((2, [16, 19]), (4, [16, 16]), (17, [0, 0])):
        blocked, _ = OccupancyMap(upright=False, min_pixels=min_pixels)(depth, 0.0)
        assert blocked.sum((1, 2)).tolist() == left
    assert torch.equal(depth, before)


def test_obstacles_are_drawn_where_they_stand():
    bars = [(0.80, 0.86, -0.3, 0.2, 0.06), (0.30, 0.36, 0.10, 0.40, 0.06)]
    depth, segments = as_tensors(*render([(bar, Label.OBSTACLE) for bar in bars], CAMERA))
    truth = standing(bars)
    upright = OccupancyMap()(depth, 0.0, segments)[0][0].numpy()
    as_seen = OccupancyMap(upright=False)(depth, 0.0, segments)[0][0].numpy()
    # Upright is right to a cell at the rim; as seen, the tops lean out by up to 6.6 px.
    assert_right_to_a_cell(upright, truth)
    assert (upright != truth).sum() < 60
    assert (as_seen != truth).sum() > 1000


def test_object_and_robot_do_not_block_and_low_things_do_not_either():
    things = [
        (BAR, Label.OBSTACLE),
        (square(0.7, 0.1), Label.OBJECT),
        (square(0.7, -0.1, height=0.3), Label.ROBOT),
        (square(0.4, 0.3, height=0.012), Label.OBSTACLE),
        (square(0.4, -0.3, height=0.014), Label.OBSTACLE),
    ]
    depth, segments = as_tensors(*render(things, CAMERA))
    blocked = OccupancyMap()(depth, 0.0, segments)[0][0].numpy()
    assert_right_to_a_cell(blocked, standing([BAR, square(0.4, -0.3)]))
    assert not blocked[standing([square(0.7, 0.1), square(0.7, -0.1), square(0.4, 0.3)])].any()


def test_without_a_segmentation_the_object_is_what_stands_around_its_pose():
    things = [(BAR, Label.OBSTACLE), (square(0.7, 0.1), Label.OBJECT)]
    depth, _ = as_tensors(*render(things, CAMERA))
    position, radius = torch.tensor([[0.7, 0.1]]), 0.0354
    with_pose = OccupancyMap()(depth, radius, None, position)[0][0].numpy()
    alone, _ = as_tensors(*render(things[:1], CAMERA))
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
    before = render([(low, Label.OBSTACLE)], CAMERA)
    after = render([(low, Label.OBSTACLE), (square(0.725, 0.0, height=0.06), Label.OBJECT)], CAMERA)
    blocked = OccupancyMap()
    free_view, bits = blocked(as_tensors(before[0])[0], 0.0, as_tensors(before[1])[0])
    depth, segments = as_tensors(*after)
    forgotten, _ = blocked(depth, 0.0, segments)
    remembered, bits_after = blocked(depth, 0.0, segments, previous=bits)
    assert forgotten.sum() < free_view.sum()
    assert torch.equal(remembered, free_view)
    assert torch.equal(bits_after, bits)
    gone, segments = as_tensors(*render([], CAMERA))
    assert not blocked(gone, 0.0, segments, previous=bits)[0].any()  # seen to be gone


def test_what_stands_nearer_than_it_is_seen_is_remembered_too():
    """The arm hides the far half of a bar's top, which is seen 5 % farther out than it stands."""
    bar = (0.80, 0.86, -0.3, 0.2, 0.06)
    depth, segments = as_tensors(*render([(bar, Label.OBSTACLE)], CAMERA))
    blocked = OccupancyMap()
    free_view, bits = blocked(depth, 0.0, segments)
    middle = CAMERA.project(torch.tensor([0.83, 0.0]), 0.06)[1].round().int()
    depth[:, :middle], segments[:, :middle] = 0.7, int(Label.ROBOT)
    forgotten, _ = blocked(depth, 0.0, segments)
    remembered, bits_after = blocked(depth, 0.0, segments, previous=bits)
    assert 0 < forgotten.sum() < 0.7 * free_view.sum()
    assert torch.equal(remembered, free_view)
    assert torch.equal(bits_after, bits)


def test_scenes_that_are_left_out_keep_their_grid():
    images = [render([(square(x, 0.1), Label.OBSTACLE)], CAMERA) for x in (0.5, 0.6, 0.7)]
    depth, segments = (torch.from_numpy(np.stack(of)) for of in zip(*images, strict=True))
    blocked = OccupancyMap()
    every = torch.ones(3, dtype=torch.bool)
    before = blocked(depth, 0.03, segments, scenes=~every)  # nothing to keep yet: computed
    assert torch.equal(before[0], OccupancyMap()(depth, 0.03, segments)[0])
    order = [1, 2, 0]
    only = torch.tensor([False, True, False])
    after = blocked(depth[order], 0.03, segments[order], scenes=only)
    for grid, old in zip(after, before, strict=True):
        assert torch.equal(grid, torch.stack([old[0], old[2], old[2]]))
    # The grids of the others are still those of their last images.
    moved = blocked(depth, 0.03, segments, scenes=every)
    assert all(torch.equal(grid, old) for grid, old in zip(moved, before, strict=True))


def test_nothing_is_inflated_again_while_obstacles_stand_still():
    blocked, bits = OccupancyMap(), None
    for k in range(12):
        position = 0.35 + 0.02 * k, 0.25 - 0.005 * k
        depth, segments = as_tensors(
            *render([(BAR, Label.OBSTACLE), (square(*position), Label.OBJECT)], CAMERA)
        )
        occupancy, bits = blocked(depth, 0.0354, segments, previous=bits)
    assert blocked.inflations == 1
    occupancy_again, _ = blocked(depth, 0.05, segments, previous=bits)  # another object
    assert blocked.inflations == 2
    assert occupancy_again.sum() > occupancy.sum()


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        (
            (torch.ones(1, 256, 256).double(), 0.03),
            TypeError,
            "depth must be a torch.float32 tensor",
        ),
        ((torch.ones(1, 64, 64), 0.03), ValueError, r"depth must be \[B, 256, 256\]"),
        ((torch.full((1, 256, 256), 1100.0), 0.03), ValueError, "depth must be in metres"),
        ((torch.full((1, 256, 256), torch.inf), 0.03), ValueError, "depth must be in metres"),
    ],
)
def test_bad_images_are_refused(arguments, error, message):
    with pytest.raises(error, match=message):
        OccupancyMap()(*arguments)


def test_one_pixel_within_the_camera_s_height_is_enough():
    depth = torch.full((2, 256, 256), torch.inf)
    depth[0, 3, 250] = depth[1, 128, 128] = 1.0
    OccupancyMap()(depth, 0.03)
    with pytest.raises(ValueError, match="in scene 1"):
        OccupancyMap()(depth.index_fill(2, torch.tensor([128]), torch.nan), 0.03)
