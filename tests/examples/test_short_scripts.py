"""`demo.py`, `evaluate.py` and `train.py`, each for a few episodes or steps."""

from pathlib import Path

import pytest

from modpush.training import TRAIN_PRESETS
from tests.examples import load_example
from tests.training.conftest import SHORT


def test_demo(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    load_example("demo").main("slot", 1, tmp_path / "video.mp4")
    printed = capsys.readouterr().out
    assert "agent      arrives in" in printed
    assert "corridor   arrives in" in printed
    assert (tmp_path / "video.mp4").stat().st_size > 1000


def test_evaluate(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = load_example("evaluate").main("smoke", 2, tmp_path)
    assert {name: len(frame) for name, frame in rows.items()} == {"agent": 2, "corridor": 2}
    assert "agent against corridor" in capsys.readouterr().out
    assert (tmp_path / "agent" / "smoke" / "table.md").is_file()


def test_train(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(TRAIN_PRESETS, "smoke", SHORT)
    load_example("train").main("smoke", 1, tmp_path / "run")
    assert "of 4 new episodes" in capsys.readouterr().out
