"""`two_stages.py`: which agent acts, and a few episodes."""

from pathlib import Path

import pytest
import torch

from tests.examples import load_example


def test_the_second_agent_takes_over_near_the_goal_and_gives_back_far_from_it() -> None:
    is_near = load_example("two_stages").is_near
    before = torch.tensor([False, False, False, True, True])[:, None]
    distance = torch.tensor([0.20, 0.14, 0.14, 0.20, 0.26])[:, None]
    longer = torch.tensor([0.0, 0.0, 0.01, 0.1, 0.0])[:, None]
    near = is_near(before, distance, distance + longer)
    assert near.flatten().tolist() == [False, True, False, True, False]


def test_two_episodes_past_an_obstacle(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = load_example("two_stages").main(2, 30.0, tmp_path, ("one_cross",))
    assert table["success"].item() == 1.0
    assert "pose/one_cross/box/30deg" in capsys.readouterr().out
