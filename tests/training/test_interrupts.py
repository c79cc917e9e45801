"""Runs that are killed, interrupted, damaged or doubled."""

import errno
import os
import pickle
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from types import SimpleNamespace

import psutil
import pytest
import torch

from modpush._folder_lock import FolderLock, FolderLockedError
from modpush.training import Trainer, check_run_folder
from modpush.training.run_folder import RunFolder
from modpush.training.signals import interrupts_noted
from tests.damage import damages
from tests.full_disk import full_disk
from tests.test_files import Poison
from tests.training.conftest import SMOKE
from tests.training.test_training import assert_same, numbers, start, train, wait_for_checkpoint

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


@pytest.mark.parametrize(
    ("asynchronous", "places"),
    [(False, (32, 144, 160)), pytest.param(True, (144,), marks=pytest.mark.slow)],
)
def test_an_interrupted_run_goes_on_as_if_nothing_had_been(
    unbroken, tmp_path, asynchronous, places
):
    """While acting at random, after the first checkpoint and evaluation, and twice in a row."""
    config = replace(SMOKE, async_collection=asynchronous)
    folder = tmp_path / "run"
    for number, steps in enumerate(places):
        interrupt_after(Trainer(config, folder, resume=number > 0), steps)
        checkpoints = RunFolder(folder).checkpoints
        assert checkpoints.step(checkpoints.latest()) == steps
    train(folder, config, resume=True)
    assert_same(numbers(unbroken), numbers(folder))


@pytest.mark.parametrize("n_steps", [3, pytest.param(1, marks=pytest.mark.slow)])
def test_steps_that_wait_for_their_returns_are_kept(tmp_path, n_steps):
    config = replace(SMOKE, replay=replace(SMOKE.replay, n_steps=n_steps, storage="tensor"))
    train(tmp_path / "unbroken", config)
    interrupt_after(Trainer(config, tmp_path / "run"), 112)
    train(tmp_path / "run", config, resume=True)
    assert_same(numbers(tmp_path / "unbroken"), numbers(tmp_path / "run"))


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
def test_a_signal_to_all_processes_ends_a_run_with_a_checkpoint(unbroken, tmp_path, name):
    folder = tmp_path / "run"
    process = start(folder, "--train.async-collection", start_new_session=True)
    wait_for_checkpoint(folder, process)
    os.killpg(process.pid, getattr(signal, name))
    output, _ = process.communicate(timeout=120)
    assert process.returncode == 130, output
    assert "Continue with --resume" in output
    train(folder, replace(SMOKE, async_collection=True), resume=True)
    assert_same(numbers(unbroken), numbers(folder))


def test_under_nohup_a_run_outlives_its_terminal(hang_up):
    signal.signal(signal.SIGHUP, signal.SIG_IGN)  # what nohup does before it begins a program
    run = SimpleNamespace(interrupted=False)
    with interrupts_noted(run):
        os.kill(os.getpid(), signal.SIGHUP)
        assert not run.interrupted
        os.kill(os.getpid(), signal.SIGTERM)
        assert run.interrupted
    assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN


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


def test_a_damaged_checkpoint_is_left_for_the_one_before(unbroken, copied):
    older, newest = RunFolder(copied).checkpoints.paths()
    newest.write_bytes(newest.read_bytes()[:-1])
    with pytest.warns(
        UserWarning, match=rf"{newest.name} is cut short.*continues from.*{older.name}"
    ):
        train(copied, resume=True)
    assert_same(numbers(unbroken), numbers(copied))
    assert newest.with_name(f"{newest.name}.damaged").exists()


def test_without_a_whole_checkpoint_nothing_is_resumed(copied):
    for path in RunFolder(copied).checkpoints.paths():
        path.write_bytes(b"")
    with pytest.raises(
        ValueError, match=r"no checkpoint in .* is intact: .*; .*carries no checksum"
    ):
        Trainer(SMOKE, copied, resume=True)
    Trainer(SMOKE, copied.with_name("other")).close()  # and the lock has been released


@pytest.mark.parametrize("flips", [60, pytest.param(200, marks=pytest.mark.slow)])
def test_every_damage_of_a_checkpoint_is_noticed(copied, flips):
    folder = RunFolder(copied)
    path = folder.checkpoints.latest()
    whole, refused = path.read_bytes(), 0
    for other in folder.checkpoints.paths()[:-1]:
        other.unlink()
    for content in damages(whole, flips, flips // 2):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=path.name):
            folder.checkpoints.load()
        refused += 1
    assert refused == flips + flips // 2


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
    with pytest.warns(UserWarning, match="continues from the one before"):
        Trainer(SMOKE, copied, resume=True).close()
    assert not mark.exists()


def test_a_run_that_ended_before_its_first_checkpoint_can_begin_again(unbroken, tmp_path):
    folder = tmp_path / "run"
    Trainer(SMOKE, folder).close()  # as a kill leaves it: config and log, no checkpoint
    (folder / ".log.csv.host.1.tmp").touch()
    Trainer(SMOKE, folder).close()
    with pytest.warns(UserWarning, match="ended before its first checkpoint; it begins anew"):
        train(folder, resume=True)
    assert_same(numbers(unbroken), numbers(folder))


def test_what_killed_writes_left_is_removed(copied):
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    name = f".step-000000320.safetensors.{os.uname().nodename}.{dead.pid}.tmp"
    (copied / "checkpoints" / name).touch()
    (copied / name).touch()
    Trainer(SMOKE, copied, resume=True).close()
    assert not list(copied.rglob(".*.tmp"))


def test_a_second_process_is_told_who_writes(copied):
    code = (
        "import sys, time; from modpush._folder_lock import FolderLock\n"
        "lock = FolderLock(sys.argv[1]); print(flush=True); time.sleep(600)"
    )
    holder = subprocess.Popen([sys.executable, "-c", code, copied], stdout=subprocess.PIPE)
    holder.stdout.readline()
    try:
        with pytest.raises(
            FolderLockedError, match=rf"in use by process {holder.pid} on .* since 20"
        ):
            Trainer(SMOKE, copied, resume=True)
    finally:
        holder.kill()
        holder.communicate()
    Trainer(SMOKE, copied, resume=True).close()  # a lock ends with its process


def test_a_run_holds_its_folder_until_it_is_closed(tmp_path):
    trainer = Trainer(SMOKE, tmp_path / "run")
    with pytest.raises(FolderLockedError, match=f"process {os.getpid()} on"):
        Trainer(SMOKE, tmp_path / "run")
    trainer.close()
    FolderLock(tmp_path / "run").release()


def test_a_file_system_without_locks_is_warned_of(tmp_path, monkeypatch) -> None:
    def refuse(*_):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr("fcntl.flock", refuse)
    with pytest.warns(UserWarning, match=r"has no locks \(No locks available\).*second process"):
        lock = FolderLock(tmp_path / "run")
    assert str(os.getpid()) in lock.path.read_text(encoding="utf-8")
    lock.release()


def test_a_full_disk_at_every_write_leaves_the_run_alive(unbroken, tmp_path):
    """No file may be larger than 300 bytes."""
    trainer = Trainer(SMOKE, tmp_path / "run")
    with full_disk(300), pytest.warns(UserWarning, match="could not be written") as warned:
        trainer.run()
    first = [str(w.message).split(" could")[0].removeprefix("Trainer: ") for w in warned]
    assert sorted(set(first)) == sorted(first), "one warning each"
    assert {"log.csv", "the checkpoint", "last_agent.safetensors"} <= set(first)
    assert not RunFolder(tmp_path / "run").checkpoints.paths()
    assert trainer.steps == SMOKE.total_steps


def test_a_worker_ends_with_a_killed_parent_at_once(tmp_path):
    folder = tmp_path / "run"
    process = start(folder, "--train.async-collection", "--train.rollout-length", "100000")
    deadline = time.monotonic() + 120
    while not (workers := psutil.Process(process.pid).children()):
        assert time.monotonic() < deadline
        time.sleep(0.02)
    time.sleep(3)  # within a rollout of hours
    process.kill()
    process.communicate()
    _, alive = psutil.wait_procs(workers, timeout=20)
    assert not alive


def test_the_check_of_a_folder_writes_nothing(copied):
    before = sorted(copied.rglob("*"))
    check_run_folder(copied, SMOKE, resume=True)
    assert sorted(copied.rglob("*")) == before
