import math

import numpy as np

from modpush.geometry import box, capsule, cylinder, prism
from modpush.geometry.shapes import rpy_matrix

SQUARE = ((0.02, 0.02), (-0.02, 0.02), (-0.02, -0.02), (0.02, -0.02))


def test_sizes_are_halved_extents():
    assert box(0.1, 0.2, 0.3).size == (0.05, 0.1, 0.15)
    assert cylinder(0.03, 0.06).size == capsule(0.03, 0.06).size == (0.03, 0.03, 0.0)
    assert prism(SQUARE, 0.04).size == (0.02, 0.02, 0.02)


def test_rotations_are_about_fixed_axes_as_in_urdf():
    part = cylinder(0.03, 0.06, rpy=(math.pi / 2, 0.0, math.pi / 2))
    # Roll takes the axis z to -y, and yaw then -y to x.
    np.testing.assert_allclose(part.rotation() @ [0, 0, 1], [1, 0, 0], atol=1e-12)


def test_roll_comes_first_then_pitch_and_yaw_last():
    roll, pitch, yaw = 0.3, -0.7, 1.9
    about_x, about_y, about_z = (
        rpy_matrix(angles) for angles in ((roll, 0.0, 0.0), (0.0, pitch, 0.0), (0.0, 0.0, yaw))
    )
    np.testing.assert_allclose(
        rpy_matrix((roll, pitch, yaw)), about_z @ about_y @ about_x, atol=1e-12
    )
    # Each turns one axis towards the next: y towards z, z towards x, x towards y.
    for matrix, angle, first in ((about_x, roll, 1), (about_y, pitch, 2), (about_z, yaw, 0)):
        cos, sin = math.cos(angle), math.sin(angle)
        one, next_one = np.eye(3)[first], np.eye(3)[(first + 1) % 3]
        np.testing.assert_allclose(matrix @ one, cos * one + sin * next_one, atol=1e-12)
        np.testing.assert_allclose(matrix @ next_one, cos * next_one - sin * one, atol=1e-12)
