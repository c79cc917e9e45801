"""Stored windows and their augmentation."""

import pytest
import torch

from tests.examples import load_example

WINDOWS = load_example("window_data")
WindowData, augment_windows = WINDOWS.WindowData, WINDOWS.augment_windows


def some_data(count=6):
    return WindowData.from_floats(
        torch.rand(count, 1, 64, 64),
        torch.arange(count, dtype=torch.uint8),
        torch.arange(count) >= count - 2,
        {"families": ["slot", "blank"], "seed": 3},
    )


def test_values_come_back_to_half_a_level():
    windows = torch.rand(2, 1, 64, 64)
    data = WindowData.from_floats(windows, torch.zeros(2).byte(), torch.zeros(2).bool(), {})
    torch.testing.assert_close(data.floats(), windows, atol=0.5001 / 255, rtol=0)
    assert data.floats(torch.tensor([1])).shape == (1, 1, 64, 64)


def test_parts_are_joined_and_chosen_from():
    data = WindowData.join([some_data(3), some_data(4)])
    assert len(data) == 7
    chosen = data.where(data.held_out)
    assert chosen.family.tolist() == [1, 2, 2, 3]


def test_augmentation_turns_mirrors_and_keeps_every_height():
    torch.manual_seed(0)
    window = torch.zeros(1, 1, 64, 64)
    window[0, 0, 3, 10] = 0.75
    out = augment_windows(window.expand(64, -1, -1, -1), torch.zeros(64, 1, 64, 64))
    assert torch.equal(out.flatten(1).sum(1), torch.full((64,), 0.75))
    places = {tuple(place) for place in (out[:, 0] > 0).nonzero()[:, 1:].tolist()}
    a, b = (3, 60), (10, 53)  # 63 - 3 and 63 - 10
    assert places == {(x, y) for x in a for y in b} | {(y, x) for x in a for y in b}


def test_another_window_is_laid_over_but_blank_ones_stay_blank():
    torch.manual_seed(0)
    windows = torch.zeros(200, 1, 64, 64)
    windows[100:, 0, 31, 31] = 0.5
    others = torch.full((200, 1, 64, 64), 0.6)
    out = augment_windows(windows, others, overlay=0.5)
    assert (out[:100] == 0).all()
    share = (out[100:].flatten(1).amax(1) == 0.6).float().mean()
    assert share == pytest.approx(0.5, abs=0.15)
