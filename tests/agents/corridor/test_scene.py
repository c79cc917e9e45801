"""Distances to obstacles by hand."""

import numpy as np
import pytest
import scipy.ndimage as ndi
import torch

from modpush.agents.corridor.scene import (
    ObstacleDistances,
    away_from_obstacles,
    least_clearance,
    obstacle_distance,
)
from modpush.geometry import Camera
from tests.agents.corridor.corridor_scenes import wall


def test_distances_are_exact():
    distance = obstacle_distance(wall())
    expected = ndi.distance_transform_edt(~wall())
    np.testing.assert_allclose(distance, expected, atol=1e-3)
    assert np.isinf(obstacle_distance(np.zeros((3, 3), bool))).all()


def test_distances_depend_on_the_images_alone():
    camera = Camera(height=40, width=60)
    caching = ObstacleDistances(camera)
    depth = torch.full((2, 40, 60), camera.z)
    labels = torch.zeros(2, 40, 60, dtype=torch.uint8)
    for columns in (slice(0, 40), slice(0, 40), slice(20, 60)):
        depth[:] = camera.z
        depth[0, torch.from_numpy(wall(columns=columns))] = camera.z - 0.02
        got = caching(depth, labels)
        for one, expected in zip(got, ObstacleDistances(camera)(depth, labels), strict=True):
            np.testing.assert_allclose(one, expected, rtol=1e-6)  # OpenCV rounds by alignment
        assert (got[0][20, 50] == 0) == (columns.stop > 50)  # the wall has moved
        assert np.isinf(got[1]).all()


def test_clearance_along_a_segment_by_hand():
    distance = obstacle_distance(wall())
    assert least_clearance(distance, 50.0, 5.0, 50.0, 35.0) == pytest.approx(11)  # column 39 to 50
    assert least_clearance(distance, 5.0, 5.0, 5.0, 35.0) == 0
    assert least_clearance(distance, 5.0, 5.0, 30.0, 5.0) == pytest.approx(13)
    assert least_clearance(distance, -90.0, -90.0, -80.0, -80.0) == np.inf


def test_away_from_obstacles_by_hand():
    distance = obstacle_distance(wall())
    assert away_from_obstacles(distance, 10.0, 14.0) == pytest.approx((0.0, -1.0, 4.0), abs=1e-3)
    assert away_from_obstacles(distance, 44.0, 20.0)[0] == pytest.approx(1.0, abs=1e-3)
    assert away_from_obstacles(np.full((5, 5), np.inf, np.float32), 2, 2) == (0.0, 0.0, np.inf)
