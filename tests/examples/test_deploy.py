"""`deploy.py`: an episode from depth image to arm, and a folder that is continued."""

from pathlib import Path

import pytest

from tests.examples import load_example

pytest.importorskip("mujoco")


def test_an_episode_is_pushed_tracked_and_not_run_twice(tmp_path: Path) -> None:
    main = load_example("deploy").main
    (row,) = main("any_object", tmp_path, 1).to_dict("records")
    assert row["success"]
    assert not row["stopped"]
    assert 0 < row["clear_within"] <= row["clear"] <= row["images"]
    assert (tmp_path / "push.mp4").stat().st_size > 10_000
    assert "| bar_across | 1 | 1.00 |" in (tmp_path / "report.md").read_text()
    video = (tmp_path / "push.mp4").stat().st_mtime_ns
    (again,) = main("any_object", tmp_path, 1).to_dict("records")
    assert again["images"] == row["images"]
    assert (tmp_path / "push.mp4").stat().st_mtime_ns == video
