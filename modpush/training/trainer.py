"""The training loop: scenes act while the learner learns from their previous transitions."""

import functools
import time
import warnings
from collections import defaultdict
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
from numpy.typing import NDArray

from modpush._atomic import FolderLock
from modpush._precision import processor_precision
from modpush._processes import interrupts_noted, interrupts_raised, torch_threads
from modpush._types import Count
from modpush._validation import checked_arguments
from modpush.recipes.make_env import make_push_env
from modpush.replay.buffer import make_replay_buffer
from modpush.training.config import TrainConfig, check_parts, check_picklable, replay_parts
from modpush.training.held_out import EvaluationProgress, HeldOutEpisodes, held_out_score
from modpush.training.learner import Learner, weights_of
from modpush.training.log import RunLog, TrainingBar, quiet_torchrl
from modpush.training.run_folder import (
    RunFolder,
    check_run_folder,
    load_trainer_state,
    save_trained_agent,
    trainer_state,
)
from modpush.training.scene_worker import EnvFactory, Rollout, SceneWorker
from modpush.training.warm_start import load_initial_weights
from modpush.training.worker import (
    CollectionEndedError,
    InlineWorker,
    ProcessWorker,
    StartMethod,
    Worker,
)


class Trainer:
    """One training run in a folder.

    The worker is always one rollout ahead: while the learner learns from one, the scenes collect the
    next with the weights from before. Taking turns in one process has the same order and the same
    results.

    Args:
        config: Configuration of the run.
        folder: Folder that the run writes to; new or empty unless the run is resumed.
        resume: Continue from the newest intact checkpoint in the folder.
        parts: Your own parts as objects, instead of those that the config names: those of
            `make_push_env` (`ENV_PARTS`), `loss`, `actor`, `critic` (see `make_tqc`), `sampler`,
            `similarity` (see `make_replay_buffer`). A resumed run needs the same parts.
        make_env: Function that makes the environment: `make_push_env` or your own with its arguments.
            With `async_collection` both processes call it, since the learner's process runs half of the
            held-out episodes.
        start_method: Start method of the worker's process, see `ProcessWorker`.
        threads: Number of torch's threads in this process while `run` trains; the worker's uses one.
            Sums are rounded differently with another number.

    Raises:
        FolderLockedError: If another process writes to the folder.
        FileExistsError: If the folder is not empty and `resume` is False.
        FileNotFoundError: If there is nothing to resume.
        ValueError: If the folder holds a run of another config, or a part is of an unknown kind or
            cannot be given to another process.
    """

    @checked_arguments
    def __init__(
        self,
        config: TrainConfig,
        folder: Path | str,
        *,
        resume: bool = False,
        parts: Mapping[str, Any] | None = None,
        make_env: EnvFactory = make_push_env,
        start_method: StartMethod = "spawn",
        threads: Count = 1,
    ) -> None:
        if config.num_collectors > 1 and config.collector != "ray":
            raise ValueError(
                f"Trainer: num_collectors={config.num_collectors} needs collector='ray', got "
                f"{config.collector!r}."
            )
        config = _with_precision(config, folder)
        parts = dict(parts or {})
        own_process = config.async_collection and start_method == "spawn"
        spawned = own_process or config.collector == "ray"
        check_parts(config, parts, pickled=spawned)
        if spawned:
            check_picklable("make_env", make_env)
        make_replay_buffer(config.filled_replay(), **replay_parts(parts))  # refused before all else
        self.config, self.parts, self.make_env = config, parts, make_env
        self.threads = threads
        self.folder = check_run_folder(folder, config, resume=resume)
        self._progress = EvaluationProgress()
        self._workers_progress = EvaluationProgress(self._progress)
        # One thread, since a process that forks must have no other threads.
        with torch_threads(1), ExitStack() as undo:
            self.lock = FolderLock(folder)
            undo.callback(self.lock.release)
            check_run_folder(folder, config, resume=resume)
            self.worker = self._make_worker(start_method)
            undo.callback(self.worker.close)
            self.specs = self.worker.call(SceneWorker.specs)
            self._begin_learner(resume)
            undo.pop_all()

    def _make_worker(self, start_method: StartMethod) -> Worker:
        config = self.config
        if config.collector == "ray":
            from modpush.training.ray_worker import RayWorker

            return RayWorker(config, self.parts, self.make_env)
        make_worker = functools.partial(
            SceneWorker, config, self.parts, self.make_env, progress=self._workers_progress
        )
        if config.async_collection:
            return ProcessWorker(make_worker, start_method)
        return InlineWorker(make_worker)

    def _begin_learner(self, resume: bool) -> None:
        config = self.config
        self.learner = Learner(config, self.specs, self.parts, self.folder.path)
        self.steps, self.checkpoints_made = 0, 0
        self.seconds = 0.0
        """Time trained in sessions before this one [s]."""
        self.seconds_waited = 0.0
        """Time that the learner waited for rollouts since the log was last written [s]."""
        self.curriculum_state: dict[str, Any] = {}
        self.evaluation_due = False
        """True if the evaluation after the last rollout was interrupted."""
        self.finished = False
        """True if the run ends after the last rollout."""
        self._saved_at = -1
        self.bar = TrainingBar(replace(config, progress=False))
        self.episodes: dict[str, list[float]] = defaultdict(list)
        """Values that the episodes reported since the log was last written, by name."""
        self.held_out: HeldOutEpisodes | None = None
        """Runs this process's share of the held-out episodes, where it has one."""
        if config.async_collection and (config.collector, config.tqc.device) == ("local", "cpu"):
            self.held_out = HeldOutEpisodes(config, self.parts, self.make_env, self._progress)
        self.log = RunLog(config, self.folder)
        if resume and self.folder.checkpoints.latest() is None:
            warnings.warn(
                f"Trainer: the run in {self.folder.path} ended before its first checkpoint; it "
                "starts again.",
                stacklevel=3,
            )
        elif resume:
            load_trainer_state(self, self.folder.checkpoints.load())
        if config.init_from and not self.steps:
            load_initial_weights(self.learner, config, self.specs, self.parts)
        self.log.begin()
        self.folder.write_config(config)
        self._began = time.perf_counter() - self.seconds
        self._mark = (self._began + self.seconds, self.steps, self.learner.updates)

    @property
    def interrupted(self) -> bool:
        """Set it to end the run as a signal does: after the present rollout, or within an evaluation."""
        return bool(self._progress.stop.value)

    @interrupted.setter
    def interrupted(self, value: bool) -> None:
        self._progress.stop.value = int(value)

    @property
    def ended(self) -> bool:
        """True once the run has made `total_steps` or taken `max_minutes`."""
        limit = self.config.max_minutes
        out_of_time = limit is not None and self.minutes() >= limit
        return self.steps >= self.config.total_steps or out_of_time

    def run(self) -> dict[str, float]:
        """Train until `total_steps` or `max_minutes`, or until SIGINT (Ctrl-C), SIGTERM or SIGHUP.

        A signal ends the run after the present rollout, or at once within an evaluation, with a
        checkpoint from which it continues with new episodes. A second signal ends it at once; it then
        continues from the previous checkpoint.

        Returns:
            The best evaluation (`held_out_score`), a row of `evaluations.csv`; empty before the first.

        Raises:
            KeyboardInterrupt: After a signal.
            NonFiniteLossError: After the batch was saved for inspection.
            CollectionEndedError: If the Ray cluster that the scenes act on is gone; after a checkpoint.
        """
        self.bar = TrainingBar(self.config, self.steps)
        try:
            with torch_threads(self.threads), quiet_torchrl(), interrupts_noted(self):
                self._run()
        except CollectionEndedError:
            self.save()
            raise
        finally:
            self.bar.close()
            self.close()
        return self.best_evaluation()

    def _run(self) -> None:
        if self.evaluation_due:
            self._evaluate()
        self._check_interrupt()
        # Until the scenes act there is nothing that the newest checkpoint does not hold.
        with interrupts_raised(), self.bar.pause("starting"):
            self._first_rollout()
        evaluated = [row["step"] for row in self.log.evaluations[-1:]] == [self.steps]
        # One whose time is over is still to end like a completed one.
        self.finished = self.steps >= self.config.total_steps or (self.ended and evaluated)
        while not self.finished:
            if self.interrupted and self.steps != self._saved_at:
                self.worker.discard()
                self.save()
            self._check_interrupt()
            self._iterate()
        if self.evaluation_due:
            self._check_interrupt()

    def _check_interrupt(self) -> None:
        """Raise after an interrupt; all that the run needs to continue has been written."""
        if self.interrupted:
            newest = self.folder.checkpoints.latest()
            raise KeyboardInterrupt(
                f"Stopped before the first checkpoint in {self.folder.path}; begin again."
                if newest is None
                else f"Stopped; a checkpoint is in {self.folder.path}. Continue with resume=True."
            )

    def _first_rollout(self) -> None:
        self.learner.forget_open_steps()
        if self.curriculum_state:
            self.worker.call(SceneWorker.set_state, self.curriculum_state)
        self.worker.call(SceneWorker.restart, self.worker_seed())
        self.collect()

    def _iterate(self) -> None:
        """Take one rollout, and learn while the next one is collected."""
        config = self.config
        asked = time.perf_counter()
        rollout: Rollout = self.worker.result()
        self.seconds_waited += time.perf_counter() - asked
        before = self.steps
        self.store(rollout)
        self.bar.advance(self.steps - before)
        self.finished = self.ended
        due = {
            name: self.steps // every > before // every or self.finished
            for name, every in (
                ("evaluate", config.evaluate_every),
                ("checkpoint", config.checkpoint_every),
                ("log", config.log_every),
            )
        }
        pause = due["evaluate"] or due["checkpoint"]
        if not pause:
            self.collect()
        self.learner.learn(before, self.steps)
        if due["log"]:
            self._write_log(rollout)
        if due["evaluate"]:
            self._evaluate()
        if due["checkpoint"]:
            with self.bar.pause("writing a checkpoint"):
                self.save()
            self._saved_at = self.steps
        if pause and not self.finished:
            self.collect()

    def close(self) -> None:
        """End the worker and the logs, and let others write to the folder."""
        self.worker.close()
        if self.held_out is not None:
            self.held_out.close()
        self.log.close()
        self.lock.release()

    def save(self) -> None:
        """Write a checkpoint, and begin new episodes: what resumes from it does the same."""
        self.checkpoints_made += 1
        self.curriculum_state = self.worker.call(SceneWorker.get_state)
        self.seconds = time.perf_counter() - self._began
        # The worker's draws come from a seed of this checkpoint; restarting first makes the saved
        # random state the one with which the run continues.
        self.worker.call(SceneWorker.restart, self.worker_seed())
        if self.config.collector == "local":  # on a cluster the scenes are not restarted
            self.learner.forget_open_steps()
        self.folder.checkpoints.save(self.steps, trainer_state(self))

    def worker_seed(self) -> int:
        """Seed of the scenes after the newest checkpoint.

        Scene i takes seed + i: far enough apart for the scenes of any two runs and restarts.
        """
        return (1_000_003 * (self.config.seed + 1) + 10_007 * self.checkpoints_made) % 2**62

    @property
    def _acts_at_first(self) -> bool:
        """True while the scenes act as `TrainConfig.first_actions` says."""
        return self.steps < self.config.tqc.learning_starts and not self.config.init_from

    def collect(self) -> None:
        """Have the scenes act with the present policy; `worker.result` gives the rollout."""
        weights = None if self._acts_at_first else self.learner.actor_weights()
        self.worker.submit(SceneWorker.collect, self.config.rollout_length, weights)

    def store(self, rollout: Rollout) -> None:
        """Put a rollout into the buffer, and its episodes into the log."""
        self.steps += self.learner.store(rollout)
        if self.config.collector == "ray":
            self.episodes["collector/behind"].append(float(rollout.behind))
        for episode in rollout.episodes:
            kind = "greedy" if episode["greedy"] else "noisy"
            for name in ("success", "contact", "collision", "steps", "return", "out_of_bounds"):
                self.episodes[f"{kind}/{name}"].append(episode[name])

    def _write_log(self, rollout: Rollout) -> None:
        """Write a row of the log, and show it."""
        now, (then, steps, updates) = time.perf_counter(), self._mark
        learner = self.learner
        self._mark = (now, self.steps, learner.updates)
        seen = {**self.episodes, **learner.metrics}
        row = {name: sum(values) / len(values) for name, values in seen.items() if values}
        self.episodes.clear()
        learner.metrics.clear()
        row |= {f"family/{name}": value for name, value in rollout.success_by_family.items()}
        row["curriculum/level"] = float(rollout.level)
        row["speed/steps"] = (self.steps - steps) / (now - then)
        row["speed/updates"] = (learner.updates - updates) / (now - then)
        row["speed/waiting"] = self.seconds_waited / (now - then)
        self.seconds_waited = 0.0
        row["minutes"] = self.minutes()
        row["updates"] = float(learner.updates)
        self.log.write(self.steps, row)
        curriculum = self.config.curriculum.promotion != "off"
        self.bar.show(
            row,
            random=self._acts_at_first,
            level=str(rollout.level) if curriculum else "",
            best=self.best_evaluation().get("success"),
        )

    def minutes(self) -> float:
        """Time trained, in all sessions [min]."""
        return (time.perf_counter() - self._began) / 60

    def best_evaluation(self) -> dict[str, float]:
        """The evaluation of the best agent so far (`held_out_score`); empty before the first."""
        return max(self.log.evaluations, key=held_out_score, default={})

    def _evaluate(self) -> None:
        weights = weights_of(self.learner.averaged_actor)
        with self.bar.pause(f"evaluating {self.config.evaluation_episodes} episodes"):
            found = self.held_out_rows(weights)
        self.evaluation_due = self.interrupted  # some episodes may not have ended
        if self.evaluation_due:
            return
        rows = pd.DataFrame(found)
        summary = self.log.write_evaluation(self.steps, self.learner.updates, self.minutes(), rows)
        save_trained_agent(self, self.folder.last_agent, summary)
        if self.best_evaluation() is self.log.evaluations[-1]:
            save_trained_agent(self, self.folder.best_agent, summary)

    def held_out_rows(self, weights: dict[str, NDArray]) -> list[dict[str, Any]]:
        """Run the held-out episodes: half of them here, if this process would only wait for them."""
        count = self.config.evaluation_episodes

        def show() -> None:
            ended = self._progress.ended.value + self._workers_progress.ended.value
            self.bar.say(f"evaluating {ended}/{count}")

        self._progress.on_episode = self._workers_progress.on_episode = show
        self._workers_progress.ended.value = 0
        if self.held_out is None:
            return self.worker.call(SceneWorker.evaluate, weights)
        self.worker.submit(SceneWorker.evaluate, weights, range(count // 2))
        ours = self.held_out.run(self.learner.averaged_actor, range(count // 2, count))
        while not self.worker.wait(0.2):
            show()
        return [*self.worker.result(), *ours]


def _with_precision(config: TrainConfig, folder: Path | str) -> TrainConfig:
    """The config with the precision that a run in the folder has, or that is faster on this processor."""
    if config.tqc.precision != "auto":
        return config
    begun = RunFolder(folder)
    stored = begun.stored_config().tqc.precision if begun.config.exists() else "auto"
    precision = processor_precision() if stored == "auto" else stored
    return replace(config, tqc=replace(config.tqc, precision=precision))
