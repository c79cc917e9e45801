"""Training and evaluation sets on a real local Ray cluster of two nodes."""

import copy
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import psutil
import pytest
import torch
import yaml
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase

import modpush
from modpush._precision import networks_in
from modpush._processes import ray_session
from modpush.agents import ScriptedPusher
from modpush.envs import PushEnv
from modpush.evaluation import EvaluationConfig, EvaluationSet, evaluate, load_set
from modpush.recipes.agent_file import load_agent
from modpush.training import TRAIN_PRESETS, TrainConfig, Trainer
from modpush.training.learner import Learner
from modpush.training.run_folder import RunFolder
from modpush.training.scene_worker import Rollout, SceneWorker
from modpush.training.worker import InlineWorker
from tests.training.conftest import SMOKE

pytestmark = pytest.mark.ray

TWO = replace(SMOKE, collector="ray", num_collectors=2)


def collector_processes() -> list[psutil.Process]:
    found = psutil.process_iter(["cmdline"])
    return [p for p in found if "ray::SceneCollector" in " ".join(p.info["cmdline"] or [])]


class Noting(Trainer):
    """A trainer that keeps all rollouts and weights, and does something after one of the rollouts."""

    rollouts: list[Rollout]
    sent: list[dict[str, Any]]
    after: dict[int, Callable[[], Any]]

    def collect(self) -> None:
        self.sent.append(self.learner.actor_weights())
        super().collect()

    def store(self, rollout: Rollout) -> None:
        self.rollouts.append(rollout)
        super().store(rollout)
        self.after.pop(len(self.rollouts), lambda: None)()


def run_noting(
    config: TrainConfig, folder: Path, after: dict[int, Callable[[], Any]] | None = None
) -> Noting:
    trainer = noting(config, folder, after or {})
    trainer.run()
    return trainer


def noting(config: TrainConfig, folder: Path, after: dict[int, Callable[[], Any]]) -> Noting:
    trainer = Noting(config, folder)
    trainer.rollouts, trainer.sent, trainer.after = [], [], after
    return trainer


def check_continuous(rollouts: list[Rollout], num_envs: int) -> list[int]:
    """Each collector's rollouts go on where its last one ended; returns the sources that began."""
    ends: dict[int, Any] = {}
    begun = []
    for rollout in rollouts:
        if rollout.begins:
            begun.append(rollout.source)
        else:
            first = rollout.transitions["observation"][:num_envs]
            np.testing.assert_array_equal(first, ends[rollout.source])
        ends[rollout.source] = rollout.last_observation
    return begun


@pytest.fixture(scope="module")
def trained(cluster: Any, tmp_path_factory: pytest.TempPathFactory) -> Noting:
    """A finished run of two collectors."""
    return run_noting(TWO, tmp_path_factory.mktemp("trained") / "run")


def test_two_collectors_train(trained: Noting) -> None:
    trainer, rollouts, folder = trained, trained.rollouts, trained.folder
    assert sorted(check_continuous(rollouts, TWO.env.num_envs)) == [0, 1]
    assert trainer.steps == TWO.total_steps == len(trainer.learner.buffer)
    assert {r.version for r in rollouts if r.begins} == {1}, "both begin with what was sent first"
    later = [r.version for r in rollouts if not r.begins]
    assert len(later) > 2
    assert len(set(later)) == len(later), "each goes on with what was sent to it alone"
    for source in (0, 1):  # the learner's curriculum reaches both
        levels = [r.level for r in rollouts if r.source == source]
        assert levels == sorted(levels)
    table = pd.read_csv(folder.log)
    # While the second collector made its first rollout, the first one delivered and got newer weights.
    assert max(r.behind for r in rollouts) >= 1
    # A row is a mean over its rollouts, some of which may be of one collector twice in a row.
    assert table["collector/behind"].max() > 0
    assert table["speed/waiting"].between(0, 1).all()
    assert len(pd.read_csv(folder.evaluations)) == 2
    # Ray ends a killed actor's process some moments after it has answered.
    _, alive = psutil.wait_procs(collector_processes(), timeout=60)
    assert not alive, "the collectors must end with the run"
    assert load_agent(folder.path / "last_agent.safetensors").policy is not None


@pytest.mark.slow
def test_an_agent_learns(cluster: Any, tmp_path: Path) -> None:
    """0.68 of 120 held-out episodes after these steps in `benchmarks/bench_scale.py`."""
    config = replace(
        TRAIN_PRESETS["cpu"],
        collector="ray",
        total_steps=45_000,
        evaluate_every=45_000,
        evaluation_episodes=48,
        checkpoint_every=100_000,
        progress=False,
    )
    assert Trainer(config, tmp_path / "run").run()["success"] > 0.3


@pytest.mark.slow
def test_a_collector_that_is_killed_is_begun_again(cluster: Any, tmp_path: Path) -> None:
    config = replace(TWO, total_steps=100_000, evaluate_every=100_000, checkpoint_every=100_000)
    trainer = noting(config, tmp_path / "run", {4: lambda: collector_processes()[0].kill()})
    store = trainer.store

    def store_until_begun_again(rollout: Rollout) -> None:
        store(rollout)
        if [r.begins for r in trainer.rollouts[:-4]].count(True) == 3:
            trainer.interrupted = True

    trainer.store = store_until_begun_again  # type: ignore[method-assign]
    with pytest.raises(KeyboardInterrupt):
        trainer.run()
    check_continuous(trainer.rollouts, config.env.num_envs)
    stored = [r.transitions for r in trainer.rollouts]
    rows = np.concatenate([np.hstack([t["observation"], t["action"]]) for t in stored])
    assert len(np.unique(rows, axis=0)) == len(rows), "no transition may come twice"
    assert trainer.steps == len(rows) == len(trainer.learner.buffer)


@pytest.mark.slow
def test_continues_after_an_interrupt_and_on_one_machine(cluster: Any, tmp_path: Path) -> None:
    trainer = noting(TWO, tmp_path / "run", {})
    trainer.after = {5: lambda: setattr(trainer, "interrupted", True)}
    with pytest.raises(KeyboardInterrupt):
        trainer.run()
    seen = trainer.steps
    assert 0 < seen < TWO.total_steps
    resumed = Trainer(TWO, tmp_path / "run", resume=True)
    assert resumed.steps == seen, "what had been stored must be in the checkpoint"
    assert resumed.curriculum_state == trainer.curriculum_state
    resumed.run()
    assert resumed.steps == TWO.total_steps == len(resumed.learner.buffer)
    longer = replace(SMOKE, total_steps=240)
    local = Trainer(longer, tmp_path / "run", resume=True)
    local.run()
    assert local.steps == 240
    back = Trainer(replace(TWO, total_steps=288), tmp_path / "run", resume=True)
    back.run()
    assert back.steps == 288


def rows_of(learner: Learner) -> list[tuple[float, ...]]:
    """What a learner has stored: observation, action, sum of rewards and the observation after."""
    every = learner.buffer[:]
    columns = [every["observation"], every["action"], every["next", "reward"]]
    return [tuple(row) for row in torch.cat([*columns, every["next", "observation"]], -1).tolist()]


def test_steps_of_two_collectors_are_not_summed_together(tmp_path: Path) -> None:
    config = replace(SMOKE, replay=replace(SMOKE.replay, n_steps=3))
    worker = InlineWorker(partial(SceneWorker, config))
    worker.call(SceneWorker.restart, 0)
    learners = [Learner(config, worker.call(SceneWorker.specs), {}, tmp_path) for _ in range(2)]
    rollouts = [worker.call(SceneWorker.collect, 4, None) for _ in range(2)]
    others = [worker.call(SceneWorker.collect, 4, None) for _ in range(2)]
    worker.close()
    for rollout in (*rollouts, replace(others[0], begins=True), others[1]):
        learners[0].store(rollout)
    mixed = (
        replace(rollouts[0], source=0),
        replace(others[0], source=1, begins=True),
        replace(rollouts[1], source=0),
        replace(others[1], source=1),
    )
    for rollout in mixed:
        learners[1].store(rollout)
    rows = [set(rows_of(learner)) for learner in learners]
    assert len(rows[0]) > 0
    assert rows[1] == rows[0]


DRIVER = """
import sys
from dataclasses import replace
from modpush.training import Trainer
from tests.training.conftest import SMOKE

config = replace(
    SMOKE, collector="ray", total_steps=10_000_000, evaluate_every=10_000_000, log_every=32,
    checkpoint_every=160,
)
Trainer(config, sys.argv[1]).run()
"""


@pytest.mark.slow
def test_a_run_whose_cluster_is_lost_continues_from_its_last_checkpoint(tmp_path: Path) -> None:
    pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    head = {"num_cpus": 1, "include_dashboard": False}
    cluster = Cluster(initialize_head=True, head_node_args=head)
    folder = RunFolder(tmp_path / "run")
    run = subprocess.Popen(
        [sys.executable, "-c", DRIVER, str(folder.path)],
        env={**os.environ, "RAY_ADDRESS": cluster.address},
    )
    try:
        wait_for(lambda: folder.checkpoints.latest() is not None, run)
        cluster.head_node.kill_gcs_server()
        assert run.wait(180) != 0
    finally:
        run.kill()
        cluster.shutdown()
    local = Trainer(replace(SMOKE, total_steps=10_000_000), folder.path, resume=True)
    assert local.steps >= 160


@pytest.mark.parametrize("form", ["127.0.0.1:{}", "ray://127.0.0.1:{}"])
def test_a_cluster_that_is_gone_is_named_at_once(
    form: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    ray = pytest.importorskip("ray")
    address = form.format(free_port())
    monkeypatch.setenv("RAY_ADDRESS", address)
    monkeypatch.setattr(ray, "is_initialized", lambda: False)  # this process may be connected
    message = f"test: no connection to Ray: nothing answers at {address}"
    with pytest.raises(RuntimeError, match=message), ray_session("test", 1):
        pass


def free_port() -> int:
    with socket.socket() as listening:
        listening.bind(("127.0.0.1", 0))
        return int(listening.getsockname()[1])


def wait_for(condition: Callable[[], bool], process: subprocess.Popen[bytes]) -> None:
    for _ in range(1200):
        if condition():
            return
        assert process.poll() is None
        time.sleep(0.1)
    raise AssertionError("it did not happen in two minutes")


def test_the_cluster_file_is_one_that_ray_takes() -> None:
    pytest.importorskip("ray")
    from ray.autoscaler._private.util import prepare_config, validate_config

    text = (Path(modpush.__file__).parents[1] / "examples" / "cluster.yaml").read_text()
    validate_config(prepare_config(yaml.safe_load(text)))
    assert f"torch=={torch.__version__.split('+')[0]}" in text


def test_what_the_actors_act_with_is_what_was_learned(trained: Noting) -> None:
    config = trained.config
    greedy = slice(config.env.num_envs - config.greedy_envs, config.env.num_envs)
    last = trained.rollouts[-1]
    actor = copy.deepcopy(trained.learner.agent.actor)
    weights = trained.sent[last.version - 1]
    actor.load_state_dict({name: torch.from_numpy(value) for name, value in weights.items()})
    shape = (config.rollout_length, config.env.num_envs, -1)
    observation = torch.from_numpy(last.transitions["observation"]).reshape(shape)[:, greedy]
    action = torch.from_numpy(last.transitions["action"]).reshape(shape)[:, greedy]
    with networks_in(trained.learner.agent.update.precision):
        expected = actor.get_dist(TensorDict({"observation": observation})).deterministic_sample
    torch.testing.assert_close(action, expected)


QUIET = EvaluationConfig(num_envs=2, progress=False)


def make_env(num_envs: int, objects: tuple[str, ...]) -> PushEnv:
    return PushEnv(num_envs, pushed_object=objects, depth=None)


class NotingPusher(TensorDictModuleBase):
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


def evaluated(folder: Path, policy: TensorDictModuleBase, workers: Any) -> pd.DataFrame:
    config = EvaluationConfig(num_envs=2, workers=workers, progress=False)
    return evaluate(
        policy, eight_episodes(), folder, make_env=make_env, label="same", config=config
    )


def eight_episodes() -> EvaluationSet:
    return load_set("free/small_cube").first(8)


@pytest.mark.slow
def test_rows_are_those_of_one_process(cluster: Any, tmp_path: Path) -> None:
    (tmp_path / "seen").mkdir()
    rows = evaluated(tmp_path / "ray", NotingPusher(tmp_path / "seen"), "ray")
    assert len(list((tmp_path / "seen").iterdir())) >= 2, "both CPUs must have worked"
    assert not (tmp_path / "seen" / str(os.getpid())).exists()
    expected = evaluated(tmp_path / "here", NotingPusher(tmp_path / "seen"), 1)
    pd.testing.assert_frame_equal(rows, expected)


@pytest.mark.slow
def test_a_task_that_is_killed_loses_and_doubles_nothing(cluster: Any, tmp_path: Path) -> None:
    (tmp_path / "seen").mkdir()
    rows = evaluated(tmp_path / "ray", NotingPusher(tmp_path / "seen", end_once=True), "ray")
    seen = {path.name for path in (tmp_path / "seen").iterdir()}
    assert "ended" in seen
    assert rows["episode"].tolist() == list(range(8))
    expected = evaluated(tmp_path / "here", NotingPusher(tmp_path / "seen"), 1)
    pd.testing.assert_frame_equal(rows, expected)


@pytest.mark.slow
def test_a_run_of_one_process_continues_with_ray(cluster: Any, tmp_path: Path) -> None:
    (tmp_path / "seen").mkdir()
    policy = NotingPusher(tmp_path / "seen")
    begun = evaluate(
        policy,
        eight_episodes().first(3),
        tmp_path / "run",
        make_env=make_env,
        label="same",
        config=QUIET,
    )
    rows = evaluated(tmp_path / "run", policy, "ray")
    assert rows["episode"].tolist() == list(range(len(eight_episodes())))
    pd.testing.assert_frame_equal(rows[:3], begun)


@pytest.mark.slow
def test_an_error_in_a_task_is_shown(cluster: Any, tmp_path: Path) -> None:
    def broken(num_envs: int, objects: tuple[str, ...]) -> PushEnv:
        raise ValueError("this environment cannot be made")

    config = EvaluationConfig(num_envs=2, workers="ray", progress=False)
    with pytest.raises(Exception, match="this environment cannot be made"):
        evaluate(
            ScriptedPusher(), eight_episodes(), tmp_path / "run", make_env=broken, config=config
        )
