"""One training run of a sweep, in a process of its own."""

import multiprocessing
import os
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.context import SpawnProcess
from pathlib import Path

import pandas as pd

from modpush._end_with_parent import end_with_parent
from modpush.files import write_text
from modpush.sweeps.definition import Trial
from modpush.training.run_folder import RunFolder, check_run_folder

__all__ = [
    "TrialFailedError",
    "check_end",
    "is_finished",
    "run_trial",
    "start_trial",
    "trial_error",
]

_OUTPUT, _ERROR = "output.txt", "error.txt"  # in the run's folder of logs
_INTERRUPTED = 130  # exit status of a run that a signal ended


class TrialFailedError(RuntimeError):
    """A training run of a sweep ended with an error."""


def is_finished(trial: Trial, sweep_folder: Path) -> bool:
    """Whether a run has been evaluated after its last step.

    Raises:
        ValueError: If the folder holds a run of another configuration.
    """
    folder = trial.folder(sweep_folder)
    if not folder.config.exists():
        return False
    check_run_folder(folder.path, trial.config, resume=True)
    if not folder.evaluations.exists():
        return False
    return int(pd.read_csv(folder.evaluations)["step"].max()) >= trial.config.total_steps


def trial_error(folder: RunFolder) -> str:
    """Last line of the error with which a run ended; empty without one."""
    path = folder.path / "logs" / _ERROR
    return path.read_text(encoding="utf-8").strip().splitlines()[-1] if path.exists() else ""


def start_trial(trial: Trial, sweep_folder: Path) -> SpawnProcess:
    """Begin a run, or go on with it, in a process of its own, which ends with this one.

    What it prints is in its folder, in `logs/output.txt`. On `process.terminate()` it writes a
    checkpoint and ends.
    """
    folder = trial.folder(sweep_folder)
    if not folder.config.exists():
        folder.write_config(trial.config)
    # A thread for the learner, and one for the environment's process.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    process = multiprocessing.get_context("spawn").Process(target=_train, args=(trial, folder.path))
    process.start()
    return process


def check_end(trial: Trial, sweep_folder: Path, process: SpawnProcess) -> None:
    """Check how a run's process, which has ended, did so.

    Raises:
        TrialFailedError: With an error; it has been written to the run's folder.
        KeyboardInterrupt: After a signal, with a checkpoint.
    """
    if process.exitcode == _INTERRUPTED:
        raise KeyboardInterrupt
    if process.exitcode:
        folder = trial.folder(sweep_folder)
        if not (text := trial_error(folder)):  # killed, for instance where memory ran out
            text = f"ended with exit status {process.exitcode}"
            write_text(folder.path / "logs" / _ERROR, text)
        raise TrialFailedError(f"run_sweep: {trial.name}: {text}")


def run_trial(trial: Trial, sweep_folder: Path) -> None:
    """Begin a run, or go on with it, and wait for its end.

    Raises:
        TrialFailedError: If it ended with an error; it has been written to its folder.
        KeyboardInterrupt: After a signal, once the run's checkpoint is written.
    """
    process = start_trial(trial, sweep_folder)
    try:
        process.join()
    except KeyboardInterrupt:
        process.terminate()
        process.join()
        raise
    except BaseException:
        process.kill()
        raise
    check_end(trial, sweep_folder, process)


def _train(trial: Trial, path: Path) -> None:
    """The run itself, in its process."""
    if hasattr(os, "setpgrp"):
        os.setpgrp()  # the sweep passes Ctrl-C on: a second signal would end the run without a checkpoint
    end_with_parent()
    import torch

    from modpush.training.trainer import Trainer
    from modpush.training.worker import StartMethod

    torch.set_num_threads(1)
    folder = RunFolder(path)
    error = path / "logs" / _ERROR
    error.unlink(missing_ok=True)
    with _output_in(path / "logs" / _OUTPUT):
        try:
            resume = folder.checkpoints.latest() is not None
            # Nothing has run in this process yet, so that the worker may share its libraries' memory.
            how: StartMethod = "fork" if sys.platform == "linux" else "spawn"
            Trainer(trial.config, path, resume=resume, start_method=how).run()
        except KeyboardInterrupt:
            sys.exit(_INTERRUPTED)
        except BaseException:
            write_text(error, traceback.format_exc())
            raise


@contextmanager
def _output_in(path: Path) -> Iterator[None]:
    """Let standard output and error of this process, and of those that it starts, go to a file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a", encoding="utf-8", errors="replace") as file:
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
            os.dup2(file.fileno(), stream.fileno())
        yield
