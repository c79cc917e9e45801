"""Training runs as trials of Ray Tune."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from modpush._ray import ray_session
from modpush.sweeps.definition import Trial
from modpush.sweeps.results import trial_row
from modpush.sweeps.trial import run_trial

__all__ = ["run_with_ray"]


def run_with_ray(trials: Sequence[Trial], folder: Path) -> None:
    """Run trials as those of a `ray.tune.Tuner`, as many at a time as there are CPUs for.

    A trial takes two, for learner and environment, or one if none of them has `async_collection`.

    What a trial has done is in its own folder, from which it goes on wherever it is started again, so
    that Ray's record of the trials is not needed to resume.

    Args:
        trials: What is to run.
        folder: The sweep's folder, which every machine of a cluster must see under this path.

    Raises:
        MissingExtraError: If Ray is not installed.
        RuntimeError: If there is no connection to Ray, or it has fewer CPUs than a trial needs.
    """
    os.environ.setdefault("RAY_CHDIR_TO_TRIAL_DIR", "0")  # files are named from the present folder
    cpus = 2 if any(trial.config.async_collection for trial in trials) else 1
    with ray_session("run_sweep: ray=True", cpus):
        from ray import tune

        by_name = {trial.name: trial for trial in trials}
        sweep_folder = folder.resolve()

        def run(parameters: dict[str, Any]) -> None:
            trial = by_name[parameters["trial"]]
            run_trial(trial, sweep_folder)
            row = trial_row(trial, sweep_folder)
            tune.report({k: v for k, v in row.items() if isinstance(v, int | float)})

        tune.Tuner(
            tune.with_resources(run, {"cpu": cpus}),
            param_space={"trial": tune.grid_search(list(by_name))},
            run_config=tune.RunConfig(name="ray", storage_path=str(sweep_folder), verbose=1),
        ).fit()
