import math

import pytest
import torch
from hypothesis import given, strategies as st

from modpush.geometry import rotate, wrap_angle


@given(st.floats(-50, 50))
def test_wrapping_keeps_the_direction_and_lands_in_the_circle(angle):
    wrapped = wrap_angle(torch.tensor(angle, dtype=torch.float64)).item()
    assert -math.pi <= wrapped < math.pi
    assert math.cos(wrapped) == pytest.approx(math.cos(angle), abs=1e-9)
    assert math.sin(wrapped) == pytest.approx(math.sin(angle), abs=1e-9)


def test_a_quarter_turn_takes_x_to_y():
    turned = rotate(torch.tensor([[1.0, 0.0]]), torch.tensor([[math.pi / 2]]))
    torch.testing.assert_close(turned, torch.tensor([[0.0, 1.0]]), atol=1e-6, rtol=0)
