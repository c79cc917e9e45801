"""The sets with movable objects and with hidden dynamics, run as a user runs them."""

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch
from tensordict import TensorDictBase

from modpush.evaluation import EvaluationConfig, evaluate, load_set, summarize, to_display
from modpush.evaluation.report import draw_episode
from modpush.evaluation.results import DYNAMICS_COLUMNS, OBSTACLE_COLUMNS, load_trajectory
from modpush.recipes import ServedPolicy, get_method
from tests.examples import load_example

ROOT = Path(__file__).parents[2]
QUIET = EvaluationConfig(num_envs=4, progress=False)


def push_straight(td: TensorDictBase) -> TensorDictBase:
    """The policy of the example, as a function."""
    action = load_example("serve_policy").act({k: v.numpy() for k, v in td.items() if k != "path"})
    return td.set("action", torch.from_numpy(action))


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    command = [sys.executable, str(ROOT / "examples" / "serve_policy.py"), "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        yield process.stdout.readline().split()[-1]
        process.kill()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("track")


def test_a_policy_of_another_process_is_evaluated_like_a_function(
    address: str, folder: Path, tmp_path: Path
) -> None:
    method = get_method(address)
    assert method.name == "straight"
    episodes = load_set("tracks/8").first(4)
    rows = evaluate(method, episodes, folder, config=QUIET)
    own = get_method("tests.evaluation.test_benchmarks:push_straight")
    assert own.name == "push_straight"
    same = evaluate(own, episodes, tmp_path, config=QUIET)
    columns = ["success", "steps", "path_length", *OBSTACLE_COLUMNS]
    np.testing.assert_allclose(
        rows[columns].to_numpy(float), same[columns].to_numpy(float), atol=1e-6
    )
    assert rows["success"].mean() >= 0.5  # straight through what is in the way
    assert (rows["effort"] < 1).all()
    assert (rows["effort"] > 0.3).all()
    assert (rows.loc[rows["success"], "path_share"] == 1).all()


def test_the_rows_of_a_track_say_what_else_was_moved(folder: Path) -> None:
    track = load_set("tracks/8").first(4)
    rows = evaluate(get_method("scripted"), track, folder / "scripted", config=QUIET)
    assert set(OBSTACLE_COLUMNS) <= set(rows.columns)
    assert not set(DYNAMICS_COLUMNS) & set(rows.columns)
    table = to_display(summarize({"scripted": rows}))
    assert set(OBSTACLE_COLUMNS) <= set(table.columns)
    for number, scenario in enumerate(track):
        trajectory = load_trajectory(folder / "scripted", number)
        poses = trajectory.obstacle_pose
        assert poses is not None
        assert poses.shape == (rows["steps"][number] + 1, 8, 4)
        start = np.array([o.pose for o in scenario.obstacles])
        np.testing.assert_allclose(poses[0, :, :2], start[:, :2], atol=1e-5)
        moved = np.linalg.norm(np.diff(poses[..., :2], axis=0), axis=-1).sum()
        assert (moved > 1e-3) == (rows["effort"][number] < 0.999)
    hit = int(rows["effort"].argmin())
    pictures = [
        draw_episode(track.scenarios[hit], load_trajectory(folder / "scripted", hit), step=step)
        for step in (0, None)
    ]
    assert (pictures[0] != pictures[1]).any()


def test_the_rows_of_hidden_dynamics_say_what_was_hidden(tmp_path: Path) -> None:
    episodes = load_set("hidden_dynamics").first(3)
    rows = evaluate(get_method("scripted"), episodes, tmp_path, config=QUIET)
    assert set(DYNAMICS_COLUMNS) <= set(rows.columns)
    assert rows["mass"].tolist() == [s.dynamics.mass for s in episodes]
    assert rows["friction"].tolist() == [s.dynamics.friction for s in episodes]
    assert "side_changes" in summarize({"scripted": rows})
    again = evaluate(get_method("scripted"), episodes, tmp_path, config=QUIET)
    assert again.equals(rows)


def test_no_server_is_said_so() -> None:
    with pytest.raises(ConnectionError, match=r"no answer of http://127.0.0.1:9: .*being served"):
        get_method("http://127.0.0.1:9")
    with pytest.raises(ValueError, match=r"expected http://host:port, got 'http://x/act'"):
        ServedPolicy("http://x/act")


def test_a_function_itself_is_a_method(tmp_path: Path) -> None:
    method = get_method(push_straight)
    assert method.name == "push_straight"
    episodes = load_set("hidden_dynamics").first(1)
    rows = evaluate(method, episodes, tmp_path, config=QUIET)
    named = get_method("tests.evaluation.test_benchmarks:push_straight")
    assert evaluate(named, episodes, tmp_path, config=QUIET).equals(rows)  # of the same policy
    with pytest.raises(ValueError, match=r"got function. get_method\(policy\) gives a function"):
        evaluate(push_straight, episodes, tmp_path)


def test_a_part_that_is_no_policy_is_refused() -> None:
    with pytest.raises(ValueError, match=r"must be a function of a tensordict or a Method, got 3"):
        get_method("math:pi")
    with pytest.raises((TypeError, ValueError), match="get_method: policy"):
        get_method(3)
