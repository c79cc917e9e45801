import math

import cv2
import numpy as np
import pytest

from modpush.envs.scenes.objects import OBJECTS
from modpush.geometry import Primitive, box, capsule, centered, cylinder
from modpush.geometry.footprint import inscribed_radius, outline_of

L_SHAPE = centered(box(0.10, 0.03, 0.04), box(0.03, 0.07, 0.04, (0.035, 0.05, 0.0)))


@pytest.mark.parametrize(
    ("parts", "expected"),
    [
        ((box(0.08, 0.05, 0.05),), 0.025),
        ((box(0.08, 0.05, 0.05, (0.03, 0.0, 0.0)),), 0.01),  # 4 cm - 3 cm to its nearest side
        ((cylinder(0.03, 0.06),), 0.03),
        ((capsule(0.03, 0.1, (0.01, 0.0, 0.0)),), 0.02),
        ((box(0.08, 0.05, 0.05, (0.05, 0.0, 0.0)),), 0.0),  # the origin is outside
        ((cylinder(0.03, 0.06, (0.0, 0.05, 0.0)),), 0.0),
        # Two boxes that touch, and two that overlap, make one of 8 x 4 cm.
        ((box(0.04, 0.04, 0.04, (-0.02, 0, 0)), box(0.04, 0.04, 0.04, (0.02, 0, 0))), 0.02),
        ((box(0.06, 0.04, 0.04, (-0.01, 0, 0)), box(0.06, 0.04, 0.04, (0.01, 0, 0))), 0.02),
        # A cross: up to its inner corners.
        ((box(0.10, 0.02, 0.04), box(0.02, 0.10, 0.04)), 0.01 * math.sqrt(2.0)),
    ],
)
def test_by_hand(parts: tuple[Primitive, ...], expected: float) -> None:
    assert inscribed_radius(parts) == pytest.approx(expected, abs=2e-6)


@pytest.mark.parametrize(
    "parts", [OBJECTS["fragment"].parts, L_SHAPE, centered(*L_SHAPE, cylinder(0.03, 0.04))]
)
def test_as_measured_in_an_image_of_the_footprint(parts: tuple[Primitive, ...]) -> None:
    scale, size = 10_000.0, 2001  # 0.1 mm a pixel, the origin in the middle
    image = np.zeros((size, size), np.uint8)
    for part in parts:
        corners = outline_of(part, 256) * scale + size // 2
        cv2.fillConvexPoly(image, np.rint(corners).astype(np.int32), 1)
    distance = cv2.distanceTransform(image, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    measured = distance[size // 2, size // 2] / scale
    assert inscribed_radius(parts) == pytest.approx(measured, abs=3e-4)
