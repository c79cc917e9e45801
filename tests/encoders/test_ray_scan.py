"""The ray scan, by hand."""

import torch

from modpush.encoders import RayScan


def test_clearances_by_hand():
    window = torch.zeros(2, 1, 64, 64)
    window[0, 0, 10:12, :] = 0.75  # a wall ahead: rows 11 and 10
    window[0, 0, :, 50:] = 0.6  # and one to the right
    scan = RayScan(4, max_range=32.0, pixel_size=1.0)(window)
    # From 31.5: row 11 begins at 11.5, 20 px ahead; column 50 at 49.5, 18 px to the right.
    expected = torch.tensor([[20 / 32, 1.0, 1.0, 18 / 32], [1.0, 1.0, 1.0, 1.0]])
    torch.testing.assert_close(scan, expected, atol=0.51 / 32, rtol=0)


def test_a_quarter_turn_of_the_window_moves_the_rays_on():
    window = torch.zeros(1, 1, 64, 64)
    window[..., 5:14, 22:43] = window[..., 30:60, 50:55] = 1.0
    assert (RayScan(16)(window) < 1).any()
    turned = RayScan(16)(torch.rot90(window, 1, (-2, -1)))  # what was ahead is now to the left
    torch.testing.assert_close(turned.roll(-4, -1), RayScan(16)(window), atol=1.1 / 32, rtol=0)
