"""Which checkpoints a folder keeps."""

from pathlib import Path

import pytest

from modpush.training.run_folder import Checkpoints


@pytest.mark.parametrize("keep", [1, 3])
def test_the_newest_are_kept_as_many_as_asked_for(tmp_path: Path, keep: int) -> None:
    checkpoints = Checkpoints(tmp_path, keep)
    (tmp_path / "notes.txt").touch()
    # Past nine digits a name no longer sorts as its number does.
    steps = [9, 10, 999_999_999, 1_000_000_000]
    for step in steps:
        checkpoints.save(step, {"step": step})
    assert [checkpoints.step(path) for path in checkpoints.paths()] == steps[-keep:]
    assert checkpoints.load() == {"step": 1_000_000_000}
    assert (tmp_path / "notes.txt").exists()
