import math

import numpy as np
import pytest

from modpush.geometry import WORKSPACE, Rectangle


def test_bounds_are_the_rectangle_with_a_margin_on_every_side():
    low, high = Rectangle((0.0, -1.0), (2.0, 3.0)).bounds(0.5)
    assert (low, high) == ((-0.5, -1.5), (2.5, 3.5))


def test_an_episode_ends_5_cm_outside_the_workspace():
    (x0, y0), (x1, y1) = WORKSPACE.bounds()
    assert (x0, y0, x1, y1) == pytest.approx((0.15, -0.40, 0.80, 0.40))


def test_corners_run_counter_clockwise():
    corners = Rectangle((0.0, -1.0), (2.0, 3.0)).corners()
    edges = np.roll(corners, -1, axis=0) - corners
    turns = (
        edges[:, 0] * np.roll(edges, -1, axis=0)[:, 1] - edges[:, 1] * np.roll(edges, -1, 0)[:, 0]
    )
    assert (turns > 0).all()
    assert {tuple(corner) for corner in corners.tolist()} == {(0, -1), (2, -1), (2, 3), (0, 3)}


@pytest.mark.parametrize(
    ("place", "velocity", "expected"),
    [
        ((0.5, 0.25), (0.0, 0.1), 1.0),
        ((0.5, 0.25), (0.0, -0.1), 6.0),
        ((0.7, 0.25), (0.1, 0.1), 0.5),
        ((0.5, 0.4), (0.0, 0.1), math.inf),
        ((0.5, 0.4), (0.0, -0.1), 7.5),
        ((0.5, 0.0), (-0.1, 0.0), 3.0),
        ((0.5, 0.25), (0.0, 0.0), math.inf),
    ],
)
def test_the_time_to_the_edge_is_that_of_the_nearest_edge_on_the_way(place, velocity, expected):
    assert WORKSPACE.time_to_edge(np.array(place), np.array(velocity)) == pytest.approx(expected)
