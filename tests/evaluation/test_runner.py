import importlib
import multiprocessing
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import psutil
import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.envs import ExplorationType

from modpush._atomic import FolderLock, FolderLockedError
from modpush._state import weights_hash
from modpush.agents import ScriptedPusher
from modpush.envs import EpisodeConditions, PushEnv
from modpush.evaluation.episodes import Episode
from modpush.evaluation.results import (
    COLUMNS,
    ResultStore,
    describe_policy,
    load_trajectory,
    policy_hash,
)
from modpush.evaluation.runner import EvaluationConfig, evaluate
from modpush.evaluation.sets import EvaluationSet, load_set
from modpush.recipes import get_method
from tests.evaluation.conftest import make_env, make_episode

MADE, OTHER = {"class": "made"}, {"class": "other"}
QUIET = EvaluationConfig(num_envs=3, progress=False)


def fail(num_envs: int, objects: object) -> None:
    raise AssertionError("nothing is left to run, so no environment is needed")


def break_down(num_envs: int, objects: object) -> None:
    raise RuntimeError("no such machine")


def leave(num_envs: int, objects: object) -> None:
    raise SystemExit(0)


@pytest.fixture(scope="module")
def unbroken(tmp_path_factory: pytest.TempPathFactory) -> pd.DataFrame:
    folder = tmp_path_factory.mktemp("unbroken")
    episodes = load_set("free/small_cube").first(10)
    return evaluate(ScriptedPusher(), episodes, folder, make_env=make_env, config=QUIET)


def assert_same_results(first: pd.DataFrame, second: pd.DataFrame) -> None:
    pd.testing.assert_frame_equal(first, second, rtol=1e-3, atol=1e-3)


def test_rows_are_complete_and_in_order(unbroken: pd.DataFrame) -> None:
    assert tuple(unbroken.columns) == COLUMNS
    assert unbroken["episode"].tolist() == list(range(10))
    assert unbroken["success"].dtype == bool
    assert not unbroken.isna().any().any()
    assert unbroken["success"].mean() >= 0.8


def run_in_two_processes(folder: Path) -> None:
    config = EvaluationConfig(num_envs=3, workers=2, progress=False)
    episodes = load_set("free/small_cube").first(20)
    evaluate(ScriptedPusher(), episodes, folder, make_env=make_env, config=config)


@pytest.mark.filterwarnings("ignore:.*use of fork:DeprecationWarning")
def test_a_killed_run_leaves_no_worker_and_continues_where_it_stopped(
    tmp_path: Path, unbroken: pd.DataFrame
) -> None:
    context = multiprocessing.get_context("fork")
    process = context.Process(target=run_in_two_processes, args=(tmp_path,))
    process.start()
    csv, deadline = tmp_path / "episodes.csv", time.monotonic() + 240
    while not csv.exists() or csv.read_text().count("\n") < 3:
        assert process.is_alive(), "the run ended before it could be killed"
        assert time.monotonic() < deadline
        time.sleep(0.005)
    workers = psutil.Process(process.pid).children(recursive=True)
    assert len(workers) >= 2
    process.kill()
    process.join()
    _, alive = psutil.wait_procs(workers, timeout=30)
    assert not alive
    kept = csv.read_text()
    assert 2 <= kept.count("\n") - 1 < 20
    csv.write_text(kept + "9,free,small_cu")  # and a row that was cut off
    before = csv.stat().st_size

    episodes = load_set("free/small_cube").first(20)
    rows = evaluate(ScriptedPusher(), episodes, tmp_path, make_env=make_env, config=QUIET)
    assert csv.read_text().startswith(kept)  # nothing was run again
    assert csv.stat().st_size > before
    assert_same_results(rows.head(10), unbroken)


@pytest.mark.parametrize("policy", ["corridor", "any_object"])
def test_an_interrupted_run_ends_as_an_uninterrupted_one(
    policy: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    episodes = load_set("smoke").first(8)  # two of each object
    config = EvaluationConfig(num_envs=5, progress=False)
    whole = evaluate(get_method(policy), episodes, tmp_path / "whole", config=config)
    write, written = ResultStore.write, []

    def write_some(store: ResultStore, episode: Episode) -> None:
        write(store, episode)
        written.append(episode.number)
        if len(written) in (2, 6):  # six are left, then two: fewer than there are scenes
            raise KeyboardInterrupt

    monkeypatch.setattr(ResultStore, "write", write_some)
    torch.set_num_threads(2)  # of the caller, which the evaluation leaves alone
    for _ in range(2):
        with pytest.raises(KeyboardInterrupt, match=r"[26] of 8 episodes are in .* continues"):
            evaluate(get_method(policy), episodes, tmp_path / "parts", config=config)
    rows = evaluate(get_method(policy), episodes, tmp_path / "parts", config=config)
    assert torch.get_num_threads() == 2
    torch.set_num_threads(1)
    pd.testing.assert_frame_equal(rows, whole, check_exact=True)
    for number in range(len(episodes)):
        expected, found = (
            vars(load_trajectory(tmp_path / which, number)) for which in ("whole", "parts")
        )
        for name, values in expected.items():
            np.testing.assert_array_equal(found[name], values, err_msg=name)


def test_a_finished_run_is_not_run_again(tmp_path: Path, free: EvaluationSet) -> None:
    episodes = free.first(2)
    store = ResultStore(tmp_path, episodes, describe_policy(ScriptedPusher()))
    for number in (1, 0):
        store.write(make_episode(number, episodes.scenarios[number], success=number == 1))
    rows = evaluate(ScriptedPusher(), episodes, tmp_path, make_env=fail, config=QUIET)
    assert rows["success"].tolist() == [False, True]


def test_more_episodes_can_be_asked_for_later(tmp_path: Path, free: EvaluationSet) -> None:
    store = ResultStore(tmp_path, free.first(2), MADE)
    for number in range(2):
        store.write(make_episode(number, free.scenarios[number]))
    assert ResultStore(tmp_path, free.first(5), MADE).missing() == [2, 3, 4]
    assert len(ResultStore(tmp_path, free.first(1), MADE).rows()) == 1


def test_an_episode_that_was_written_twice_counts_once(tmp_path: Path, free: EvaluationSet) -> None:
    store = ResultStore(tmp_path, free.first(2), MADE)
    for number, success in ((1, True), (0, True), (1, False)):
        store.write(make_episode(number, free.scenarios[number], success=success))
    rows = store.rows()
    assert rows[["episode", "success"]].to_numpy().tolist() == [[0, True], [1, True]]
    assert store.missing() == []


def test_another_run_is_not_mixed_in(tmp_path: Path, free: EvaluationSet) -> None:
    store = ResultStore(tmp_path, free, MADE)
    store.write(make_episode(0, free.scenarios[0]))
    with pytest.raises(ValueError, match=r"holds another run.*'policy': \(\{'class': 'made'\}"):
        ResultStore(tmp_path, free, OTHER)
    with pytest.raises(ValueError, match=r"holds another run.*'set': \('free/small_cube', 'smoke'"):
        ResultStore(tmp_path, load_set("smoke"), MADE)
    assert ResultStore(tmp_path, free, OTHER, resume=False).missing() == list(range(500))
    assert not list((tmp_path / "trajectories").iterdir())


@pytest.mark.slow  # the process alone takes ten seconds to start
@pytest.mark.parametrize("make", [break_down, leave])
def test_a_worker_that_ends_early_is_reported(
    make: Callable[..., None], tmp_path: Path, free: EvaluationSet
) -> None:
    config = EvaluationConfig(workers=2, progress=False)
    with pytest.raises(RuntimeError, match="a worker ended early, exit codes"):
        evaluate(ScriptedPusher(), free.first(1), tmp_path, make_env=make, config=config)


class Linear(TensorDictModule):
    """A policy with weights, which do nothing here."""

    def __init__(self, weight: float) -> None:
        super().__init__(nn.Linear(3, 3), in_keys=["object_pose"], out_keys=["action"])
        nn.init.constant_(self.module.weight, weight)
        nn.init.zeros_(self.module.bias)


def test_other_weights_of_the_same_policy_are_another_policy(
    tmp_path: Path, free: EvaluationSet
) -> None:
    episodes = free.first(1)
    store = ResultStore(tmp_path, episodes, describe_policy(Linear(0.0)))
    store.write(make_episode(0, episodes.scenarios[0]))
    evaluate(Linear(0.0), episodes, tmp_path, make_env=fail, config=QUIET)
    with pytest.raises(ValueError, match=r"holds another run.*'weights'"):
        evaluate(Linear(0.1), episodes, tmp_path, make_env=fail, config=QUIET)


def test_an_edited_function_is_another_policy(
    tmp_path: Path, free: EvaluationSet, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    module, results = tmp_path / "edited_lab.py", tmp_path / "results"
    lines = "SPEED = {}\ndef push(td):\n    return td.set('action', SPEED * td['ee_pose'])\n"
    episodes = free.first(1)

    def policy(speed: float) -> object:
        """The function as a new process finds it."""
        module.write_text(lines.format(speed))
        importlib.invalidate_caches()
        monkeypatch.delitem(sys.modules, "edited_lab", raising=False)
        return importlib.import_module("edited_lab").push

    with monkeypatch.context() as patched:
        patched.setattr("sys.dont_write_bytecode", True)
        first = policy(0.5)
        store = ResultStore(results, episodes, describe_policy(first))
        store.write(make_episode(0, episodes.scenarios[0]))
        assert len(evaluate(policy(0.5), episodes, results, make_env=fail, config=QUIET)) == 1
        edited = policy(0.25)
        with pytest.raises(ValueError, match=r"holds another run.*'source'.*--fresh"):
            evaluate(edited, episodes, results, make_env=fail, config=QUIET)
        with pytest.raises(AssertionError, match="nothing is left"):  # it would run
            evaluate(edited, episodes, results, make_env=fail, config=QUIET, resume=False)


def test_functions_without_source_are_told_apart_by_their_bytecode() -> None:
    made = [
        eval(f"lambda td: [td + {number} for _ in td]", {"__name__": "nowhere"})
        for number in (1, 2, 1)
    ]
    first, second, same = (describe_policy(function) for function in made)
    assert first["class"] == second["class"]
    assert first == same != second


def test_another_set_of_the_same_name_and_first_episode_is_refused(
    tmp_path: Path, free: EvaluationSet
) -> None:
    ResultStore(tmp_path, free.first(3), MADE)
    swapped = (free.scenarios[0], *reversed(free.scenarios[1:]))
    other = EvaluationSet(name=free.name, scenarios=swapped)
    with pytest.raises(ValueError, match=r"holds another run.*'episodes'"):
        ResultStore(tmp_path, other, MADE)


def test_rows_say_which_policy_acted(tmp_path: Path, unbroken: pd.DataFrame) -> None:
    assert unbroken["policy"].nunique() == 1
    assert unbroken["policy"].iloc[0].startswith("settings:")
    first, second = (describe_policy(Linear(weight)) for weight in (0.0, 0.1))
    assert policy_hash(first) == f"weights:{weights_hash(Linear(0.0))}"
    assert policy_hash(first) != policy_hash(second)


def test_an_environment_of_other_conditions_is_refused(tmp_path: Path, free: EvaluationSet) -> None:
    short = replace(free.first(1), conditions=EpisodeConditions(max_episode_steps=7))
    with pytest.raises(ValueError, match=r"set\): \{'max_episode_steps': \(200, 7\)\}"):
        evaluate(ScriptedPusher(), short, tmp_path / "a", make_env=make_env, config=QUIET)
    rows = evaluate(
        ScriptedPusher(), short, tmp_path / "b", make_env=make_conditioned_env, config=QUIET
    )
    assert rows["steps"].tolist() == [7]
    with pytest.raises(ValueError, match=r"holds another run.*'conditions'"):
        evaluate(ScriptedPusher(), free.first(1), tmp_path / "b", make_env=fail, config=QUIET)


def make_conditioned_env(num_envs: int, objects: object, conditions: EpisodeConditions) -> PushEnv:
    return PushEnv(num_envs, pushed_object=objects, depth=None, **conditions.env_options)


def test_two_evaluations_of_one_folder_are_refused(tmp_path: Path, free: EvaluationSet) -> None:
    with FolderLock(tmp_path), pytest.raises(FolderLockedError, match="in use by another process"):
        evaluate(ScriptedPusher(), free.first(2), tmp_path, make_env=fail, config=QUIET)


def test_drawn_actions_are_of_the_configs_seed_and_another_run_with_another(
    tmp_path: Path, free: EvaluationSet, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn = []

    def note(env: object, policy: object, episodes: object, **options: object) -> list[Episode]:
        drawn.append((torch.rand(1).item(), options["inflation"], options["exploration"]))
        return [make_episode(number, scenario) for number, scenario in episodes]

    monkeypatch.setattr("modpush.evaluation.runner.run_episodes", note)
    made = SimpleNamespace(close=lambda: None)
    tight = replace(free.first(1), conditions=EpisodeConditions(inflation="inscribed"))
    for seed, folder in ((3, "a"), (3, "b"), (4, "c")):
        config = replace(QUIET, deterministic=False, seed=seed)
        evaluate(go_left, tight, tmp_path / folder, make_env=lambda *_: made, config=config)
    assert drawn[0] == drawn[1]
    assert drawn[0][0] != drawn[2][0]
    assert drawn[0][1:] == ("inscribed", ExplorationType.RANDOM)
    with pytest.raises(ValueError, match=r"holds another run.*'seed': 3.*'seed': 4"):
        evaluate(go_left, tight, tmp_path / "a", make_env=fail, config=config)


def go_left(td: TensorDict) -> TensorDict:
    return td.set("action", td["ee_pose"].new_tensor([0.0, 0.5, 0.0]).expand(*td.shape, 3).clone())


def test_the_first_part_of_a_set_comes_back_from_its_file(
    tmp_path: Path, free: EvaluationSet
) -> None:
    part = free.first(2)
    part.save(tmp_path / "part.json.gz")
    assert load_set(tmp_path / "part.json.gz") == part
