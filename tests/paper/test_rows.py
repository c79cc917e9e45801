"""Rows of episodes: the authors' yardsticks, and the way from folders to the file and back."""

import itertools
import json
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest

from modpush.evaluation import EvaluationSet, load_set
from modpush.evaluation.results import COLUMNS
from paper import blocks, rows, tables
from paper.authors_paths import authors_agent_length, authors_controller_length
from paper.measure import Running, run_methods
from paper.rows import Rows, add_yardsticks, collect_rows, write_rows
from paper.set_statistics import set_statistics
from tests.paper.test_authors_paths import PLAIN

NAME = "hard/small_cube"
LENGTHS = {"authors_agent_length": 0.5, "authors_controller_length": 0.6}


def made_rows(count: int = 50, **columns: object) -> pd.DataFrame:
    """Rows as `evaluate` writes them, with figures made by hand."""
    made = dict.fromkeys(COLUMNS, 0.25) | {"scene": "maze", "success": True, "steps": 7}
    made |= {"shortest_length": 0.4, "path_length": 0.8}
    return pd.DataFrame({"episode": range(count), **{k: made[k] for k in COLUMNS[1:]}, **columns})


def fill(folder: Path, frame: pd.DataFrame, name: str = NAME) -> None:
    folder = folder / name
    folder.mkdir(parents=True)
    frame.to_csv(folder / "episodes.csv", index=False)
    (folder / "run.json").write_text(json.dumps({"set": name}))


def test_spl_by_the_authors_paths_follows_from_start_and_path() -> None:
    far = replace(PLAIN, goal_position=(0.575, -0.25))
    episodes = EvaluationSet(name="own", scenarios=(PLAIN, far))
    frame = made_rows(2, success=[True, False])
    added = add_yardsticks(frame, episodes)
    agent, controller = authors_agent_length(PLAIN), authors_controller_length(PLAIN)
    assert added["authors_agent_length"].tolist() == [agent, authors_agent_length(far)]
    assert added["spl"].tolist() == [0.5, 0.0]  # 0.4 of 0.8 m, and a failure
    assert added["spl_authors_agent"][0] == pytest.approx(agent / 0.8)
    assert added["spl_authors_controller"][0] == pytest.approx(controller / 0.8)
    # Lengths of the same starts are taken over, those of others are not.
    known = added.assign(authors_agent_length=9.0)
    known.loc[1, "shortest_length"] = 0.5
    lengths = add_yardsticks(frame, episodes, known)["authors_agent_length"]
    assert lengths.tolist() == [9.0, authors_agent_length(far)]


def test_rows_come_back_from_the_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fill(tmp_path / "runs" / "sets" / "one", made_rows(**LENGTHS))
    fill(tmp_path / "runs" / "two_agent", made_rows(50, **LENGTHS), f"{NAME}+rod")
    fill(tmp_path / "runs" / "cut", made_rows(3))
    fill(tmp_path / "runs" / "own", made_rows(3), "mine")  # not a set of the package
    (tmp_path / "runs" / "sets" / "one" / NAME / "sessions.json").write_text(
        json.dumps({"sessions": [{"commit": "abc", "machine": "here", "count": 50}]})
    )
    file = tmp_path / "rows.parquet"
    found = collect_rows(
        tmp_path / "runs", {"two_agent": "two"}, file, commit="given", machine="there"
    )
    assert write_rows(found, file)["episodes"].tolist() == [50, 50]
    assert "cut on hard/small_cube: 3 of 50 episodes, left out." in capsys.readouterr().out
    read = Rows(file)
    one = read.of("one", NAME)
    assert (one["commit"][0], one["machine"][0]) == ("abc", "here")
    assert read.of("two", f"{NAME}+rod")["commit"][0] == "given"
    assert one["spl_authors_controller"].tolist() == pytest.approx([0.75] * 50)
    assert one["success"].dtype == bool
    with pytest.raises(KeyError, match="none of 'one' on 'free/small_cube'"):
        read.of("one", "free/small_cube")

    # Rows of the same method and set are replaced, others stay. Early versions lacked some columns.
    fill(tmp_path / "more" / "one", made_rows(success=False).drop(columns="mean_jerk"))
    write_rows(collect_rows(tmp_path / "more", path=file, commit="new"), file)
    again = Rows(file)
    assert not again.of("one", NAME)["success"].any()
    assert again.of("one", NAME)["mean_jerk"].isna().all()
    assert len(again.of("two", f"{NAME}+rod")) == 50


def test_every_table_is_made_of_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    methods = (*blocks.AGENTS, blocks.WITH_THE_PAPERS_VALUES, "fragment", *tables.CONTROLLERS)
    seeds = [f"{agent}_seed_{seed}" for agent in blocks.AGENTS for seed in (1, 2)]
    sets = [f"{start}{name}" for start in blocks.STARTS for name in blocks.SETS]
    frames = [
        made_rows(40, **LENGTHS, method=method, set=name, commit="c", machine="m")
        for method, name in itertools.product([*methods, *seeds], [*sets, "hard_wide/small_cube"])
    ]
    write_rows(iter(frames), tmp_path / "rows.parquet")
    made = Rows(tmp_path / "rows.parquet")
    for module in (blocks, tables):
        monkeypatch.setattr(module, "read_rows", lambda: made)
    texts = {name: make() for name, make in blocks.BLOCKS.items()}
    assert (
        "| clutter, fragment | any | 40 | 1.000 (+0.133) / 1.000 (+0.133) / 0.867"
        in texts["agents"]
    )
    assert "| free, small cube | 1.000 | 1.000 | 0.998 |" in texts["success"]
    assert "| `free/small_cube` | 40 | 1.000 | 0.250 |" in texts["controllers"]
    assert "| 1.000, 1.000 | 0.500, 0.500 |" in texts["seeds any_object"]
    assert "| all | 40 | 1.000 | 0.500 |" in texts["families corridor"]
    table = texts["table obstacles small_cube"]
    assert table.count("### Fragment") == 2  # for each start of the tool
    assert "| commit | c |" in table
    assert "| fragment | 40 |" in table
    assert "| fragment | 40 |" not in texts["table obstacles any_object"]
    assert "| paper: agent, retrained | 1000 | 0.959 |" in table
    assert "`small_cube` minus `corridor_faithful`, paired t-tests:" in table
    assert (
        "| clutter, fragment | any | ours retrained, the paper's agent, retrained |"
        in (texts["verdicts small_cube"])
    )
    lists = texts["lists small_cube"]
    assert (
        "without `behind/hard/small_cube`, which is part of `behind/hard200/small_cube`:" in lists
    )
    # Success of 40 of 40 beside each of the paper's four objects: only the fragment's 0.867 is apart.
    assert "- obstacles, Fragment, small_cube against paper: agent: success 1.000 (0.867)" in lists


def test_the_yardsticks_of_a_set_by_hand() -> None:
    near = replace(PLAIN, object_pose=(0.475, 0.1, 0.0), goal_position=(0.475, -0.1))  # 0.2 m
    found = set_statistics(EvaluationSet(name="own", scenarios=(PLAIN, near)))
    assert found["episodes"] == 2
    assert found["under_0.3"] == 0.5
    assert found["straight"] == 1.0
    assert found["distance"] == pytest.approx(((0.2**2 + 0.3**2) ** 0.5 + 0.2) / 2)
    assert found["authors_agent"] == pytest.approx(1.0, abs=0.02)
    assert found["authors_controller"] == pytest.approx((0.5 / 0.13**0.5 + 1) / 2, abs=0.02)


def test_methods_are_run_and_their_rows_are_found(tmp_path: Path) -> None:
    running = Running(folder=tmp_path, progress=False, num_envs=1)
    run_methods(
        running, ["fragment", "corridor"], ["obstacles/fragment", "free/small_cube"], first=1
    )
    found = {
        path.parent.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("episodes.csv")
    }
    # The agent that was trained with the fragment runs with this object alone.
    assert found == {
        "fragment/obstacles/fragment",
        "corridor/obstacles/fragment",
        "corridor/free/small_cube",
    }
    folder = tmp_path / "fragment" / "obstacles" / "fragment"
    (session,) = json.loads((folder / "sessions.json").read_text())["sessions"]
    assert set(session) == {"commit", "machine"}
    assert list(collect_rows(tmp_path)) == []  # the sets are not finished
    frame = pd.read_csv(folder / "episodes.csv")
    added = add_yardsticks(frame, load_set("obstacles/fragment"))
    assert added["spl"].tolist() == pytest.approx(frame["spl"].tolist())
    assert rows.ROWS.name == "rows.parquet"


def test_rows_of_the_first_episodes_of_a_set(tmp_path: Path) -> None:
    fill(tmp_path / "runs" / "one", made_rows(5, **LENGTHS))
    (rows,) = collect_rows(tmp_path / "runs", path=tmp_path / "none", first=3)
    assert rows["episode"].tolist() == [0, 1, 2]
    assert not list(collect_rows(tmp_path / "runs", path=tmp_path / "none", first=6))
