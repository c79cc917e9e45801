"""Runs a sweep: in processes of this machine, or as trials of Ray Tune."""

import time
from collections import deque
from collections.abc import Sequence
from multiprocessing.connection import wait
from multiprocessing.context import SpawnProcess
from pathlib import Path

import pandas as pd
from tqdm import tqdm

from modpush._arguments import checked_arguments
from modpush._extras import require_extra
from modpush._folder_lock import FolderLock
from modpush._provenance import add_session
from modpush._types import Count
from modpush.sweeps.definition import Sweep, Trial
from modpush.sweeps.results import write_results
from modpush.sweeps.trial import TrialFailedError, check_end, is_finished, start_trial
from modpush.training.signals import interrupts_raised

__all__ = ["run_sweep"]


@checked_arguments
def run_sweep(
    sweep: Sweep,
    folder: Path | str,
    *,
    jobs: Count = 1,
    ray: bool = False,
    total_steps: Count | None = None,
    progress: bool = True,
) -> pd.DataFrame:
    """Train the missing runs of a sweep, and write the results.

    A run that was killed or that failed continues from its newest checkpoint, or from the
    beginning if it has none; a finished run is left alone. The folder gets a run's folder for every
    trial, `<variant>/seed_<seed>`, and `trials.csv`, `curves.csv` and `curves.png`, which are rewritten
    after every trial.

    Args:
        sweep: The sweep to run.
        folder: The sweep's folder.
        jobs: Number of runs at a time. A run with `async_collection` keeps two CPUs busy, one
            without it one; their results are the same.
        ray: Run as many trials at a time as Ray finds CPUs for, on this machine or on a cluster that
            shares the folder.
        total_steps: Environment steps of each run; None for those of the sweep.
        progress: Show a progress bar over the trials.

    Returns:
        A row for each trial, see `sweep_results`.

    Raises:
        KeyboardInterrupt: After SIGINT (Ctrl-C), SIGTERM or SIGHUP, once the runs' checkpoints are
            written.
        FolderLockedError: If another process runs a sweep in the folder.
        MissingExtraError: If Ray is asked for and not installed.
        RuntimeError: If trials failed, after all others have run; the message names them.
        ValueError: If an override is wrong, a run's folder holds another configuration, or both `jobs`
            and `ray` are given.
    """
    if ray and jobs > 1:
        raise ValueError(f"run_sweep: jobs must be 1 with ray=True, whose CPUs decide, got {jobs}.")
    if ray:
        require_extra("run_sweep: ray=True", "ray")
    folder = Path(folder)
    trials = sweep.trials(total_steps)
    with FolderLock(folder):
        missing = [trial for trial in trials if not is_finished(trial, folder)]
        began = time.perf_counter()
        try:
            if ray and missing:
                from modpush.sweeps.ray_trials import run_with_ray

                run_with_ray(missing, folder)
            else:
                with interrupts_raised():
                    _run_here(missing, folder, jobs, trials, progress)
        finally:
            results = write_results(trials, folder)
            ended = [trial for trial in missing if is_finished(trial, folder)]
            if missing:
                add_session(folder, len(ended), time.perf_counter() - began)
    failed = results[results["state"] == "failed"]
    if len(failed):
        names = ", ".join(f"{row.variant}/seed_{row.seed}" for row in failed.itertuples())
        raise RuntimeError(
            f"run_sweep: {len(failed)} of {len(trials)} trials failed: {names}; see logs/error.txt "
            "in their folders. Run again to continue them from their newest checkpoints, or delete a "
            "run's folder to start it anew."
        )
    return results


def _run_here(
    missing: Sequence[Trial], folder: Path, jobs: int, trials: Sequence[Trial], progress: bool
) -> None:
    """Run what is missing, `jobs` at a time, and write the results of all trials after each."""
    waiting = deque(missing)
    running: dict[int, tuple[Trial, SpawnProcess]] = {}  # by what tells that the process has ended
    bar = tqdm(
        total=len(trials),
        initial=len(trials) - len(missing),
        unit="trial",
        disable=not progress,
    )
    try:
        while waiting or running:
            while waiting and len(running) < jobs:
                trial = waiting.popleft()
                process = start_trial(trial, folder)
                running[process.sentinel] = (trial, process)
            bar.set_postfix_str(", ".join(trial.name for trial, _ in running.values()))
            ended = wait([*running])
            for sentinel in [one for one in running if one in ended]:
                trial, process = running.pop(sentinel)
                process.join()
                try:
                    check_end(trial, folder, process)
                except TrialFailedError as error:
                    bar.write(str(error))
                write_results(trials, folder)
                bar.update()
    except BaseException:  # a signal, most of all
        for _, process in running.values():
            process.terminate()  # each writes a checkpoint
        raise
    finally:
        for _, process in running.values():
            process.join()
        bar.close()
