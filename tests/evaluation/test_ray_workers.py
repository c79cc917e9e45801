"""Evaluation sets on a real local Ray cluster of two nodes."""

import os
import signal
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

from modpush.agents import ScriptedPusher
from modpush.envs import PushEnv
from modpush.evaluation import EvaluationConfig, EvaluationSet, evaluate, load_set

pytestmark = pytest.mark.ray

CONFIG = EvaluationConfig(num_envs=2, progress=False)


def make_env(num_envs: int, objects: tuple[str, ...]) -> PushEnv:
    return PushEnv(num_envs, pushed_object=objects, depth=None)


class Noting(TensorDictModuleBase):
    """The scripted pusher, which notes the process that it acts in."""

    def __init__(self, folder: Path, *, end_once: bool = False) -> None:
        super().__init__()
        self.pusher, self.folder, self.end_once = ScriptedPusher(), folder, end_once
        self.in_keys, self.out_keys = self.pusher.in_keys, self.pusher.out_keys
        self.calls = 0

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        (self.folder / str(os.getpid())).touch()
        self.calls += 1
        if self.end_once and self.calls == 20 and not (self.folder / "ended").exists():
            (self.folder / "ended").touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return self.pusher(tensordict)


def rows_of(folder: Path, policy: TensorDictModuleBase, workers: Any) -> pd.DataFrame:
    config = EvaluationConfig(num_envs=2, workers=workers, progress=False)
    return evaluate(policy, few(), folder, make_env=make_env, label="same", config=config)


def few() -> EvaluationSet:
    return load_set("free/small_cube").first(8)


def test_rows_are_those_of_one_process(cluster: Any, tmp_path: Path) -> None:
    (tmp_path / "seen").mkdir()
    rows = rows_of(tmp_path / "ray", Noting(tmp_path / "seen"), "ray")
    assert len(list((tmp_path / "seen").iterdir())) >= 2, "both CPUs must have worked"
    assert not (tmp_path / "seen" / str(os.getpid())).exists()
    expected = rows_of(tmp_path / "here", Noting(tmp_path / "seen"), 1)
    pd.testing.assert_frame_equal(rows, expected)


@pytest.mark.slow
def test_a_task_that_is_killed_loses_and_doubles_nothing(cluster: Any, tmp_path: Path) -> None:
    (tmp_path / "seen").mkdir()
    rows = rows_of(tmp_path / "ray", Noting(tmp_path / "seen", end_once=True), "ray")
    seen = {path.name for path in (tmp_path / "seen").iterdir()}
    assert "ended" in seen
    assert rows["episode"].tolist() == list(range(8))
    expected = rows_of(tmp_path / "here", Noting(tmp_path / "seen"), 1)
    pd.testing.assert_frame_equal(rows, expected)


@pytest.mark.slow
def test_a_run_of_one_process_continues_with_ray(cluster: Any, tmp_path: Path) -> None:
    (tmp_path / "seen").mkdir()
    policy = Noting(tmp_path / "seen")
    begun = evaluate(
        policy, few().first(3), tmp_path / "run", make_env=make_env, label="same", config=CONFIG
    )
    rows = rows_of(tmp_path / "run", policy, "ray")
    assert rows["episode"].tolist() == list(range(len(few())))
    pd.testing.assert_frame_equal(rows[:3], begun)


@pytest.mark.slow
def test_an_error_in_a_task_is_shown(cluster: Any, tmp_path: Path) -> None:
    def broken(num_envs: int, objects: tuple[str, ...]) -> PushEnv:
        raise ValueError("this environment cannot be made")

    config = EvaluationConfig(num_envs=2, workers="ray", progress=False)
    with pytest.raises(Exception, match="this environment cannot be made"):
        evaluate(ScriptedPusher(), few(), tmp_path / "run", make_env=broken, config=config)
