"""`evaluate.py` and the policies that it knows, for a few episodes."""

import itertools
from pathlib import Path

import pandas as pd
import pytest

from modpush.evaluation.results import describe_policy
from tests.examples import load_example


def test_evaluate(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    evaluate = load_example("evaluate")
    config = evaluate.EvaluateConfig(
        policy=("corridor", "scripted"), sets=("smoke",), episodes=2, pictures=2, out=tmp_path
    )
    evaluate.main(config)
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
    evaluate.main(config)  # finds all done
    assert (tmp_path / "corridor" / "smoke" / "episodes.csv").read_bytes() == before


def test_all_stands_for_the_papers_sets() -> None:
    evaluate = load_example("evaluate")
    names = evaluate.EvaluateConfig(sets=("all",)).set_names
    assert names[0] == "free/small_cube"
    assert len(names) == 6


def test_every_method_is_known_by_its_name_and_settings(tmp_path: Path) -> None:
    methods = load_example("methods")
    found = [methods.get_method(name) for name in ("corridor", "corridor_faithful", "scripted")]
    described = [describe_policy(method.make_policy()) for method in found]
    assert all(a != b for a, b in itertools.combinations(described, 2))
    assert found[1].make_policy().config.rules == "faithful"
    with pytest.raises(
        ValueError, match=r"no 'nobody', expected corridor, .*training run's folder"
    ):
        methods.get_method("nobody")


def test_the_agent_is_the_one_of_the_object_or_the_output_says_whose(
    capsys: pytest.CaptureFixture[str],
) -> None:
    methods = load_example("methods")
    own = methods.get_method("agent", ("small_cube",))
    assert capsys.readouterr().out == ""
    for objects in (("large_cube",), ("small_cube", "fragment")):
        other = methods.get_method("agent", objects)
        assert other.make_env.keywords == own.make_env.keywords == {"agent": "small_cube"}
        printed = capsys.readouterr().out
        assert f"none is shipped for {', '.join(objects)}; small_cube's agent is used" in printed
