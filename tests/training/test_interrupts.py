"""Runs that are killed, interrupted, damaged or doubled."""

import multiprocessing
import os
import pickle
import shutil
import signal
import time
from dataclasses import replace

import pandas as pd
import psutil
import pytest
import torch

from modpush._atomic import FolderLock, FolderLockedError
from modpush.training import Trainer
from modpush.training.learner import Learner
from modpush.training.run_folder import RunFolder
from modpush.training.worker import ProcessWorker
from tests.test_files import Poison
from tests.training.conftest import SHORT, SMOKE
from tests.training.test_training import (
    assert_same,
    numbers,
    resume_here,
    start,
    train,
    wait_for_checkpoint,
)

SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP")


def interrupt_after(trainer, steps):
    """Have a run end as after a signal, at the first rollout's end after some steps."""
    store = trainer.store

    def store_and_interrupt(rollout):
        store(rollout)
        trainer.interrupted = trainer.steps >= steps

    trainer.store = store_and_interrupt
    with pytest.raises(KeyboardInterrupt):
        trainer.run()


def test_an_interrupted_run_continues_from_its_checkpoint(tmp_path):
    """While acting at random, and after the first checkpoint and evaluation."""
    folder = tmp_path / "run"
    for number, steps in enumerate((32, 144)):
        interrupt_after(Trainer(SMOKE, folder, resume=number > 0), steps)
        checkpoints = RunFolder(folder).checkpoints
        assert checkpoints.step(checkpoints.latest()) == steps
    train(folder, resume=True)
    assert pd.read_csv(folder / "evaluations.csv")["step"].tolist() == [96, 192]
    assert pd.read_csv(folder / "log.csv")["updates"].iloc[-1] == 16


def test_a_resumed_run_keeps_its_precision_on_another_processor(tmp_path, monkeypatch):
    auto = replace(SMOKE, tqc=replace(SMOKE.tqc, precision="auto"))
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: {"amx_bf16": True})
    interrupt_after(Trainer(auto, tmp_path / "run"), 16)
    monkeypatch.setattr(torch.cpu, "get_capabilities", dict)
    trainer = Trainer(auto, tmp_path / "run", resume=True)
    assert trainer.learner.agent.update.precision == "bfloat16"
    trainer.close()


def test_a_run_ends_after_its_minutes_like_a_completed_one(tmp_path):
    limited = replace(SHORT, max_minutes=1e-6)
    best = train(tmp_path / "run", limited)
    folder = RunFolder(tmp_path / "run")
    assert best["step"] == 16, "the first rollout is the last"
    assert folder.checkpoints.step(folder.checkpoints.latest()) == 16
    assert folder.best_agent.exists()
    train(tmp_path / "run", replace(limited, max_minutes=60.0), resume=True)
    assert pd.read_csv(folder.evaluations)["step"].tolist() == [16, 96]


def test_a_run_uses_one_thread_and_leaves_the_caller_s_number(tmp_path, monkeypatch):
    seen, learn = set(), Learner.learn

    def counted(learner, before, now):
        seen.add(torch.get_num_threads())
        learn(learner, before, now)

    monkeypatch.setattr(Learner, "learn", counted)
    torch.set_num_threads(2)
    try:
        train(tmp_path / "run", replace(SMOKE, total_steps=32))
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(1)
    assert seen == {1}


@pytest.fixture
def hang_up():
    """SIGHUP as it is outside of `nohup`."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.mark.usefixtures("hang_up")
@pytest.mark.parametrize(
    "name", [SIGNALS[0], *(pytest.param(name, marks=pytest.mark.slow) for name in SIGNALS[1:])]
)
def test_a_signal_to_all_processes_ends_a_run_with_a_checkpoint(tmp_path, monkeypatch, name):
    folder = tmp_path / "run"
    process = start(folder, "--train.async-collection", start_new_session=True)
    wait_for_checkpoint(folder, process)
    os.killpg(process.pid, getattr(signal, name))
    output, _ = process.communicate(timeout=120)
    assert process.returncode == 130, output
    assert "Continue with --resume" in output
    best = resume_here(monkeypatch, folder).best_evaluation()
    assert best["step"] in (96, 192)


@pytest.mark.usefixtures("hang_up")
def test_every_signal_writes_a_checkpoint_and_is_left_alone_outside_a_run(tmp_path):
    numbers_of_signals = [getattr(signal, name) for name in SIGNALS]
    before = [signal.getsignal(number) for number in numbers_of_signals]
    for number in numbers_of_signals:
        folder = tmp_path / str(number)
        trainer = Trainer(SMOKE, folder)
        store = trainer.store
        trainer.store = lambda rollout: (store(rollout), os.kill(os.getpid(), number))  # noqa: B023
        with pytest.raises(KeyboardInterrupt):
            trainer.run()
        checkpoints = RunFolder(folder).checkpoints
        assert checkpoints.step(checkpoints.latest()) == 16
    assert [signal.getsignal(number) for number in numbers_of_signals] == before


@pytest.fixture
def copied(unbroken, tmp_path):
    return shutil.copytree(unbroken, tmp_path / "run")


def test_a_damaged_checkpoint_is_refused_and_without_it_the_one_before_is_used(unbroken, copied):
    _, newest = RunFolder(copied).checkpoints.paths()
    newest.write_bytes(newest.read_bytes()[:-1])
    with pytest.raises(ValueError, match=rf"{newest.name} .*checksum.*Delete the file"):
        Trainer(SMOKE, copied, resume=True)
    newest.unlink()  # and the lock has been released
    train(copied, resume=True)
    assert_same(numbers(unbroken), numbers(copied))


def test_checkpoints_of_another_run_are_refused(copied, tmp_path):
    other = replace(SMOKE, seed=5, total_steps=64)
    train(tmp_path / "other", other)
    newest = RunFolder(tmp_path / "other").checkpoints.latest()
    shutil.copy(newest, copied / "checkpoints" / "step-000000500.safetensors")
    with pytest.raises(ValueError, match="are of another run: seed: 5 -> 0"):
        Trainer(SMOKE, copied, resume=True)


def test_poison_in_a_run_folder_is_not_executed(copied, tmp_path):
    """As TorchRL's and tensordict's own loaders do with these very files."""
    mark = tmp_path / "executed"
    newest = RunFolder(copied).checkpoints.latest()
    for place in (copied / "checkpoints" / "prefetch.pkl", copied / "checkpoints" / "other.pickle"):
        place.write_bytes(pickle.dumps(Poison(mark)))
    torch.save({"x": Poison(mark)}, newest)
    with pytest.raises(ValueError, match="carries no checksum"):
        Trainer(SMOKE, copied, resume=True)
    newest.unlink()
    Trainer(SMOKE, copied, resume=True).close()
    assert not mark.exists()


def test_a_run_that_ended_before_its_first_checkpoint_can_begin_again(unbroken, tmp_path):
    folder = tmp_path / "run"
    Trainer(SMOKE, folder).close()  # as a kill leaves it: config and log, no checkpoint
    (folder / ".log.csv.host.1.tmp").touch()
    Trainer(SMOKE, folder).close()
    with pytest.warns(UserWarning, match="ended before its first checkpoint; it starts again"):
        train(folder, resume=True)
    assert_same(numbers(unbroken), numbers(folder))


def test_a_run_holds_its_folder_until_it_is_closed(tmp_path):
    trainer = Trainer(SMOKE, tmp_path / "run")
    with pytest.raises(FolderLockedError, match="in use by another process"):
        Trainer(SMOKE, tmp_path / "run")
    trainer.close()
    FolderLock(tmp_path / "run").release()


class Busy:
    """A worker whose rollout takes hours."""

    def collect(self):
        while True:
            torch.zeros(1)


def have_a_worker_collect(pipe):
    worker = ProcessWorker(Busy, "fork")
    worker.submit(Busy.collect)
    pipe.send(worker._process.pid)
    worker.result()


@pytest.mark.filterwarnings("ignore:.*use of fork:DeprecationWarning")
def test_a_worker_ends_with_a_killed_parent_at_once():
    context = multiprocessing.get_context("fork")
    ours, theirs = context.Pipe()
    process = context.Process(target=have_a_worker_collect, args=(theirs,))
    process.start()
    assert ours.poll(60)
    worker = psutil.Process(ours.recv())
    time.sleep(0.5)  # within its rollout
    process.kill()
    process.join()
    _, alive = psutil.wait_procs([worker], timeout=20)
    assert not alive
