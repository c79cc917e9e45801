"""A training run from end to end: what it leaves, and what it survives."""

import os
import resource
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pandas as pd
import psutil
import pytest
import torch
import yaml

import modpush
from modpush.recipes.paper import load_agent
from modpush.training import TRAIN_PRESETS, TrainConfig, Trainer, check_run_folder
from modpush.training.trainer import NonFiniteLossError
from modpush.training.worker import SceneWorker, held_out_scenarios

SMOKE = TRAIN_PRESETS["smoke"][1]
SMOKE_SIDE_BY_SIDE = replace(SMOKE, side_by_side=True)
SCRIPT = Path(modpush.__file__).parents[1] / "examples" / "train.py"


def train(folder, config=SMOKE, *, resume=False):
    return Trainer(config, check_run_folder(folder, config, resume=resume), resume=resume).run()


def numbers(folder):
    """What must not depend on when a run was killed."""
    table = pd.read_csv(folder / "evaluations.csv").drop(columns="minutes")
    return table, load_agent(folder / "last_agent.safetensors").policy.state_dict()


def assert_same(one, other):
    pd.testing.assert_frame_equal(one[0], other[0])
    assert one[1].keys() == other[1].keys()
    for name, value in one[1].items():
        assert torch.equal(value, other[1][name]), name


def start(folder, *arguments):
    return subprocess.Popen(
        [sys.executable, SCRIPT, "smoke", "--out", folder, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**os.environ, "PYTHONPATH": str(SCRIPT.parents[1])},
    )


def wait_for_checkpoint(folder, process, limit=240):
    deadline = time.monotonic() + limit
    while not list((folder / "checkpoints").glob("step-*")):
        assert process.poll() is None, process.stdout.read()
        assert time.monotonic() < deadline, "no checkpoint in time"
        time.sleep(0.02)


@pytest.fixture(scope="module")
def unbroken(tmp_path_factory):
    folder = tmp_path_factory.mktemp("unbroken") / "run"
    train(folder)
    return folder


def test_a_run_leaves_config_logs_agents_and_checkpoints(unbroken):
    stored = yaml.safe_load((unbroken / "config.yaml").read_text())
    assert stored["tqc"]["hidden_sizes"] == [16]
    log = pd.read_csv(unbroken / "log.csv")
    assert log["step"].iloc[-1] == 480
    assert log["updates"].iloc[-1] == 34  # (480 - 64) / 12
    assert {"learner/loss_qvalue", "noisy/success", "curriculum/level", "speed/steps"} <= set(log)
    assert log["learner/similarity"].dropna().between(-1, 1).all()
    evaluations = pd.read_csv(unbroken / "evaluations.csv")
    assert evaluations["step"].tolist() == [240, 480]
    assert {"success", "contact_rate", "success/free", "success/posts"} <= set(evaluations)
    assert len(list((unbroken / "checkpoints").glob("step-*"))) == 2
    assert list((unbroken / "logs").rglob("events.out.tfevents*"))
    assert list((unbroken / "logs" / "csv").rglob("*.csv"))
    assert load_agent(unbroken / "best_agent.safetensors").config == SMOKE.env


def test_a_run_killed_and_resumed_reaches_the_same_numbers(unbroken, tmp_path):
    folder = tmp_path / "run"
    process = start(folder)
    wait_for_checkpoint(folder, process)
    process.send_signal(signal.SIGKILL)
    assert process.wait(30) == -signal.SIGKILL
    process.stdout.close()
    train(folder, resume=True)
    assert_same(numbers(unbroken), numbers(folder))


def test_ctrl_c_writes_a_checkpoint_that_can_be_resumed(tmp_path):
    folder = tmp_path / "run"
    process = start(folder, "--train.total-steps", "100000")
    wait_for_checkpoint(folder, process)
    while pd.read_csv(folder / "log.csv")["step"].iloc[-1] <= SMOKE.checkpoint_every:
        assert process.poll() is None, process.stdout.read()
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    output, _ = process.communicate(timeout=120)
    assert process.returncode == 130, output
    assert "Go on with --resume" in output
    latest = check_run_folder(folder, SMOKE, resume=True).checkpoints.latest()
    steps = int(latest.name.removeprefix("step-"))
    assert steps > SMOKE.checkpoint_every  # written because of the interrupt
    train(folder, replace(SMOKE, total_steps=steps + 32), resume=True)


def test_side_by_side_learns_from_as_much_as_taking_turns(unbroken, tmp_path):
    train(tmp_path / "run", SMOKE_SIDE_BY_SIDE)
    log = pd.read_csv(tmp_path / "run" / "log.csv")
    alone = pd.read_csv(unbroken / "log.csv")
    assert log["step"].tolist() == alone["step"].tolist()
    assert log["updates"].tolist() == alone["updates"].tolist()


def test_the_script_shares_its_libraries_with_the_worker_which_ends_with_it(tmp_path):
    """On Linux the worker is a fork, and hears of its caller's end all the same."""
    folder = tmp_path / "run"
    process = start(folder, "--train.side-by-side", "--train.total-steps", "100000")
    wait_for_checkpoint(folder, process)
    workers = psutil.Process(process.pid).children(recursive=True)
    assert workers
    if sys.platform == "linux":
        shared = workers[0].memory_full_info()
        assert shared.uss < 0.6 * shared.rss
    process.send_signal(signal.SIGKILL)
    process.wait(30)
    process.stdout.close()
    _, alive = psutil.wait_procs(workers, timeout=60)
    assert not alive
    latest = check_run_folder(folder, SMOKE_SIDE_BY_SIDE, resume=True).checkpoints.latest()
    steps = int(latest.name.removeprefix("step-"))
    train(folder, replace(SMOKE_SIDE_BY_SIDE, total_steps=steps + 32), resume=True)


def test_a_failing_worker_process_is_heard():
    from modpush.training.worker import WorkerProcess

    worker = WorkerProcess(SMOKE)
    try:
        with pytest.raises(RuntimeError, match="restart comes first"):
            worker.call("collect", 1, None)
    finally:
        worker.close()


def test_a_folder_that_is_not_empty_is_refused(unbroken):
    with pytest.raises(FileExistsError, match="is not empty; resume it"):
        check_run_folder(unbroken, SMOKE, resume=False)


def test_nothing_to_resume_is_said(tmp_path):
    with pytest.raises(FileNotFoundError, match="holds no checkpoint"):
        check_run_folder(tmp_path, SMOKE, resume=True)


def test_a_checkpoint_of_another_config_says_which_fields_differ(unbroken):
    other = replace(SMOKE, seed=3, tqc=replace(SMOKE.tqc, hidden_sizes=(32,)))
    with pytest.raises(ValueError, match=r"tqc.hidden_sizes: \(16,\) -> \(32,\); seed: 0 -> 3"):
        check_run_folder(unbroken, other, resume=True)
    longer = replace(SMOKE, total_steps=960)
    assert check_run_folder(unbroken, longer, resume=True).path == unbroken


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"total_steps": 0}, "total_steps must be >= 1, got 0"),
        ({"greedy_scenes": 2}, r"greedy_scenes must be in \[0, 1\] with 2 scenes"),
        ({"replay": replace(SMOKE.replay, batch_size=8)}, "batch_size must be tqc.batch_size"),
        ({"tqc": replace(SMOKE.tqc, learning_starts=63)}, "learning_starts must be >= 64"),
        ({"replay": replace(SMOKE.replay, n_steps=3)}, "n_steps must be 1"),
    ],
)
def test_configs_that_cannot_work_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        replace(SMOKE, **change)


def test_every_preset_is_a_config():
    assert set(TRAIN_PRESETS) == {"cpu", "paper", "gpu", "smoke"}
    paper = TRAIN_PRESETS["paper"][1]
    assert isinstance(paper, TrainConfig)
    assert (paper.total_steps, paper.tqc.updates_per_step) == (7_000_000, 1.0)
    assert paper.replay.sampler == "attentive"


def test_a_blind_start_hears_nothing_of_the_latent(tmp_path):
    trainer = Trainer(SMOKE, check_run_folder(tmp_path / "run", SMOKE, resume=False))
    trainer.close()
    observation = torch.randn(5, trainer.observation_dim)
    other = observation.clone()
    other[:, :32] += 1.0  # the latent of RayScan comes first
    actor = trainer.agent.actor
    assert torch.equal(actor(observation)[0], actor(other)[0])
    other[:, 32] += 1.0
    assert not torch.equal(actor(observation)[0], actor(other)[0])


def test_a_loss_that_is_not_finite_stops_the_run_and_keeps_the_batch(tmp_path):
    trainer = Trainer(SMOKE, check_run_folder(tmp_path / "run", SMOKE, resume=False))
    with torch.no_grad():
        next(p for n, p in trainer.agent.loss.named_parameters() if "qvalue" in n).fill_(torch.nan)
    with pytest.raises(NonFiniteLossError, match=r"loss_\w+ is nan at update 1, step 80"):
        trainer.run()
    batch = torch.load(tmp_path / "run" / "non_finite_batch.pt")
    assert batch["observation"].shape == (16, trainer.observation_dim)


def test_a_checkpoint_that_cannot_be_written_leaves_the_one_before(tmp_path):
    trainer = Trainer(SMOKE, check_run_folder(tmp_path / "run", SMOKE, resume=False))
    trainer.worker.call("restart", 0)
    trainer._store(trainer.worker.call("collect", 4, None))
    trainer._save()
    first = trainer.folder.checkpoints.latest()
    trainer.steps += 1
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2_000, limits[1]))  # no file over 2 kB
    try:
        with pytest.warns(UserWarning, match="could not be written.*the one before stays"):
            trainer._save()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert trainer.folder.checkpoints.checkpoints() == (first,)
    trainer._load()
    trainer.close()


def test_held_out_episodes_are_the_same_in_every_run_and_of_all_families():
    one = held_out_scenarios(SMOKE)
    assert one == held_out_scenarios(replace(SMOKE, seed=5))
    assert {s.scene for s in one} == {"free", "posts"}
    assert all(0.2 <= _distance(s) <= 0.6 for s in one)


def test_the_scene_of_the_environment_is_what_is_trained_and_evaluated_on():
    config = replace(SMOKE, env=replace(SMOKE.env, scene=("slot",)))
    assert {s.scene for s in held_out_scenarios(config)} == {"slot"}
    worker = SceneWorker(config)
    curriculum = worker.curriculum
    curriculum.phase, curriculum.stage = 1, len(config.curriculum.distances) - 1
    worker.env.reset()
    assert {s.scene for s in worker.env.base_env.scenarios} == {"slot"}
    worker.close()


def _distance(scenario):
    (x, y, _), (a, b) = scenario.object_pose, scenario.goal_position
    return ((x - a) ** 2 + (y - b) ** 2) ** 0.5
