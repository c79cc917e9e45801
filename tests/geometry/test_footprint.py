import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from modpush.geometry import Primitive, box, capsule, centered, cylinder, prism
from modpush.geometry.footprint import (
    area_and_centroid,
    centroid,
    circumscribed_radius,
    outline_of,
    support,
    vertical_range,
    yaw_symmetry,
)

BAR = box(0.10, 0.03, 0.04)
L_SHAPE = (BAR, box(0.03, 0.07, 0.04, (0.035, 0.05, 0.0)))


def polygon(sides: int, radius: float = 0.04) -> tuple[tuple[float, float], ...]:
    angles = [2 * math.pi * k / sides for k in range(sides)]
    return tuple((radius * math.cos(a), radius * math.sin(a)) for a in angles)


def turned(part: Primitive, yaw: float) -> Primitive:
    return Primitive(
        kind=part.kind,
        size=part.size,
        position=part.position,
        rpy=(0, 0, yaw),
        outline=part.outline,
    )


def test_an_l_by_hand():
    # 30 and 21 cm^2 at (0, 0) and (3.5, 5) cm.
    x, y = centroid(L_SHAPE)
    assert (x, y) == pytest.approx((21 * 0.035 / 51, 21 * 0.05 / 51))
    moved = centered(*L_SHAPE)
    assert centroid(moved) == pytest.approx((0.0, 0.0), abs=1e-15)
    # The outermost corner is the end of the short leg, at (5, 8.5) cm.
    assert circumscribed_radius(moved) == pytest.approx(math.hypot(0.05 - x, 0.085 - y))


def test_the_centroid_is_weighted_by_volume():
    # 4 cm^2 by 2 cm at the origin, and as much area by 6 cm at (10, 20) cm: 8 and 24 cm^3.
    parts = (box(0.02, 0.02, 0.02), box(0.02, 0.02, 0.06, (0.10, 0.20, 0.0)))
    assert centroid(parts) == pytest.approx((0.075, 0.15))


def test_parts_are_turned_counter_clockwise():
    # The corner (5, 1.5) cm of the bar, turned by a quarter, lies at (-1.5, 5) cm.
    corners = outline_of(turned(BAR, math.pi / 2))
    assert corners[0] == pytest.approx([-0.015, 0.05])
    # Turned by 30 degrees, the bar reaches farthest at 30 degrees and not at -30.
    reach = support([turned(BAR, math.pi / 6)], 12)
    assert reach[1] == pytest.approx(0.05)
    assert reach[11] == pytest.approx(0.05 * math.cos(math.pi / 3) + 0.015 * math.sin(math.pi / 3))


@pytest.mark.parametrize(
    ("part", "expected"),
    [
        (box(0.1, 0.2, 0.04, (0.0, 0.0, 0.01)), (-0.01, 0.03)),
        (prism(polygon(5), 0.04), (-0.02, 0.02)),
        (cylinder(0.03, 0.06), (-0.03, 0.03)),
        (capsule(0.01, 0.06), (-0.04, 0.04)),  # and a half ball at each end
    ],
)
def test_vertical_ranges_by_hand(part, expected):
    assert vertical_range(part) == pytest.approx(expected)


def test_parts_of_several_heights_are_centred_between_bottom_and_top():
    base, knob = centered(box(0.1, 0.1, 0.02, (0.0, 0.0, 0.01)), cylinder(0.01, 0.04, (0, 0, 0.04)))
    assert vertical_range(base)[0] == pytest.approx(-0.03)
    assert vertical_range(knob)[1] == pytest.approx(0.03)


@given(st.floats(-3, 3), st.floats(-0.1, 0.1), st.floats(-0.1, 0.1))
def test_a_turned_and_moved_part_has_the_same_area_elsewhere(yaw, x, y):
    part = Primitive(kind="box", size=(0.05, 0.02, 0.02), position=(x, y, 0.0), rpy=(0, 0, yaw))
    area, center = area_and_centroid(outline_of(part))
    assert area == pytest.approx(0.1 * 0.04)
    assert center == pytest.approx([x, y], abs=1e-9)


def test_the_radius_holds_every_outline():
    for part in (BAR, cylinder(0.03, 0.06, (0.02, 0.01, 0)), prism(polygon(5), 0.02)):
        corners = outline_of(turned(part, 0.3), 1000)
        radius = circumscribed_radius([turned(part, 0.3)])
        assert np.linalg.norm(corners, axis=1).max() == pytest.approx(radius, rel=1e-4)


@pytest.mark.parametrize(
    ("parts", "symmetry"),
    [
        ((box(0.05, 0.05, 0.05),), 4),
        ((box(0.08, 0.05, 0.05),), 2),
        ((turned(box(0.05, 0.05, 0.05), 0.4),), 4),
        ((cylinder(0.03, 0.06), capsule(0.01, 0.1)), 0),
        ((cylinder(0.03, 0.06, (0.01, 0.0, 0.0)),), 1),
        *(((prism(polygon(n), 0.03),), n) for n in (3, 5, 6, 16)),
        ((BAR, turned(BAR, math.pi / 2)), 4),  # a cross of two bars
        (centered(box(0.025, 0.05, 0.05), box(0.025, 0.05, 0.05, (0.025, 0, 0))), 4),  # two halves
        (centered(*L_SHAPE), 1),
        # A square with a bar on top, and one with a knob off its centre.
        ((box(0.05, 0.05, 0.02, (0, 0, -0.01)), box(0.05, 0.01, 0.02, (0, 0, 0.01))), 2),
        ((box(0.05, 0.05, 0.02, (0, 0, -0.01)), cylinder(0.005, 0.02, (0.01, 0, 0.01))), 1),
    ],
)
def test_symmetry_counts_the_yaw_angles_that_look_alike(parts, symmetry):
    assert yaw_symmetry(tuple(parts)) == symmetry
