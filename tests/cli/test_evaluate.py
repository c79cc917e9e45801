"""`modpush evaluate` for a few episodes."""

from pathlib import Path

import pandas as pd
import pytest

from modpush.cli import EvaluateConfig, evaluate_policies


def test_evaluate(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = EvaluateConfig(
        policy=("corridor", "scripted"), sets=("smoke",), episodes=2, pictures=2, out=tmp_path
    )
    evaluate_policies(config)
    printed = capsys.readouterr().out
    assert "smoke: beside the paper" in printed
    assert "corridor against scripted" in printed
    assert "paper_controller" in (tmp_path / "comparison" / "smoke.md").read_text()
    for policy in ("corridor", "scripted"):
        folder = tmp_path / policy / "smoke"
        rows = pd.read_csv(folder / "episodes.csv")
        assert sorted(rows["episode"]) == [0, 1]
        assert (folder / "failures.png").exists() == (not rows["success"].all())
        assert (folder / "successes.png").exists() == rows["success"].any()
        assert {p.stem for p in (folder / "videos").iterdir()} == set(rows["scene"])
        for ending in ("md", "tex", "csv"):
            assert "success" in (folder / f"table.{ending}").read_text()

    before = (tmp_path / "corridor" / "smoke" / "episodes.csv").read_bytes()
    evaluate_policies(config)  # finds all done
    assert (tmp_path / "corridor" / "smoke" / "episodes.csv").read_bytes() == before


def test_all_stands_for_the_papers_sets() -> None:
    names = EvaluateConfig(sets=("all",)).set_names
    assert names[0] == "free/small_cube"
    assert len(names) == 6
