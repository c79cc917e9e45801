"""`modpush evaluate` for a few episodes."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from modpush.cli import EvaluateConfig, evaluate_policies
from modpush.evaluation.sets import BEHIND_SETS, EVALUATION_SETS, EvaluationSet, load_set


def test_evaluate(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = EvaluateConfig(
        policy=("corridor", "scripted"), episodes=2, num_envs=2, pictures=2, out=tmp_path
    )
    evaluate_policies(config)
    printed = capsys.readouterr().out
    assert "corridor against scripted" in printed
    assert "corridor against scripted" in (tmp_path / "comparison" / "smoke.md").read_text()
    for policy in ("corridor", "scripted"):
        folder = tmp_path / policy / "smoke"
        rows = pd.read_csv(folder / "episodes.csv")
        assert sorted(rows["episode"]) == [0, 1]
        assert (folder / "failures.png").exists() == (not rows["success"].all())
        assert (folder / "successes.png").exists() == rows["success"].any()
        assert {p.stem for p in (folder / "videos").iterdir()} == set(rows["scene"])
        for ending in ("md", "csv"):
            assert "success" in (folder / f"table.{ending}").read_text()

    before = (tmp_path / "corridor" / "smoke" / "episodes.csv").read_bytes()
    evaluate_policies(config)  # finds all done
    assert (tmp_path / "corridor" / "smoke" / "episodes.csv").read_bytes() == before


def test_the_engine_is_part_of_what_results_are_stored_under(tmp_path: Path) -> None:
    config = EvaluateConfig(
        policy=("scripted",),
        engine="mujoco",
        episodes=1,
        num_envs=1,
        pictures=0,
        videos=False,
        out=tmp_path,
    )
    (rows,) = evaluate_policies(config)["smoke"].values()
    assert len(rows) == 1
    about = json.loads((tmp_path / "scripted" / "smoke+mujoco" / "run.json").read_text())
    assert about["conditions"]["engine"] == "mujoco"
    with pytest.raises(ValueError, match=r"engine: there is no 'bullet'"):
        evaluate_policies(EvaluateConfig(engine="bullet", out=tmp_path / "out"))
    assert not (tmp_path / "out").exists()


def test_another_robot_runs_the_first_episodes_that_it_reaches(tmp_path: Path, capsys) -> None:
    known = load_set("tuning/small_cube")  # of whose episodes the Panda does not reach the tenth
    own = replace(known, name="own", scenarios=known.scenarios[8:11], digest="")
    own.save(tmp_path / "own.json.gz")
    config = EvaluateConfig(
        policy=("scripted",),
        sets=(str(tmp_path / "own.json.gz"),),
        robot="panda",
        num_envs=2,
        pictures=0,
        videos=False,
        out=tmp_path,
    )
    for rows in evaluate_policies(config).values():
        assert len(rows["scripted"]) == 2
    assert "own+panda: 2 of 3 starts are within reach." in capsys.readouterr().out


def test_all_stands_for_the_papers_sets_and_leaves_no_other_out() -> None:
    names = EvaluateConfig(sets=("smoke", "all", "tuning/hard", "free/small_cube")).set_names
    assert names == ("smoke", *EVALUATION_SETS, "tuning/hard")
    assert len(EVALUATION_SETS) == 8
    assert EvaluateConfig(sets=("behind/all",)).set_names == BEHIND_SETS
    assert len(BEHIND_SETS) == 7


def test_policies_and_sets_are_looked_up_before_an_episode_is_run(tmp_path: Path) -> None:
    def refused(message: str, **changes: Any) -> None:
        with pytest.raises(ValueError, match=message):
            evaluate_policies(EvaluateConfig(videos=False, out=tmp_path / "out", **changes))
        assert not (tmp_path / "out").exists()

    refused("nonsense", policy=("scripted",), sets=("smoke", "nonsense"))
    refused("nobody", policy=("scripted", "nobody"))
    file = tmp_path / "mine.json.gz"
    load_set("smoke").first(1).save(file)
    refused("both called 'smoke'", policy=("scripted",), sets=("smoke", str(file)))


def test_a_set_of_your_own_is_given_as_a_file(tmp_path: Path) -> None:
    EvaluationSet(name="mine", scenarios=load_set("smoke").scenarios[:1]).save(
        tmp_path / "s.json.gz"
    )
    config = EvaluateConfig(
        policy=("scripted",),
        sets=(str(tmp_path / "s.json.gz"),),
        num_envs=1,
        videos=False,
        out=tmp_path / "out",
    )
    evaluate_policies(config)
    folder = tmp_path / "out" / "scripted" / "mine"
    assert (folder / "table.md").exists()
    assert (folder / "episodes.csv").exists()


def test_a_set_is_run_with_another_tool(tmp_path: Path) -> None:
    config = EvaluateConfig(
        policy=("scripted",),
        sets=("hard/small_cube",),
        tool="rod",
        episodes=1,
        num_envs=1,
        videos=False,
        pictures=0,
        out=tmp_path,
    )
    evaluate_policies(config)
    folder = tmp_path / "scripted" / "hard" / "small_cube+rod"
    assert json.loads((folder / "run.json").read_text())["conditions"]["tool"] == "rod"


def test_a_policy_at_rest_is_moved_on(tmp_path: Path) -> None:
    """Episodes of the tuning set in most of which the actor alone stands still until the time is over."""
    tuning = load_set("tuning/hard")
    scenarios = [tuning.scenarios[n] for n in (6, 10, 11, 46, 60, 88)]
    file = tmp_path / "s.json.gz"
    replace(tuning, name="six", scenarios=scenarios).save(file)
    solved = {}
    for recovery in (False, None):
        config = EvaluateConfig(
            policy=("any_object",),
            sets=(str(file),),
            recovery=recovery,
            num_envs=6,
            videos=False,
            pictures=0,
            out=tmp_path,
        )
        rows = evaluate_policies(config)[str(file)]
        solved |= {name: int(table["success"].sum()) for name, table in rows.items()}
    assert solved["any_object_without_recovery"] < solved["any_object"]
    assert (tmp_path / "any_object_without_recovery" / "six" / "episodes.csv").exists()
