"""A policy over an evaluation set: batched, resumable, in one process or several."""

import multiprocessing
import queue
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
import torch
from tensordict import NestedKey
from torchrl.envs import EnvBase
from torchrl.envs.utils import ExplorationType
from tqdm import tqdm

from modpush.envs.scenes.scenario import Scenario
from modpush.evaluation.episodes import Episode, Policy, run_episodes
from modpush.evaluation.results import ResultStore
from modpush.evaluation.sets import EvaluationSet

__all__ = ["EnvFactory", "EvaluationConfig", "evaluate"]

EnvFactory = Callable[[int, Sequence[str]], EnvBase]
"""`(number of scenes, names of the objects that will be pushed) -> environment`. With several
workers it must be picklable: a function of a module, or a `functools.partial` of one."""


@dataclass(frozen=True, kw_only=True)
class EvaluationConfig:
    """How episodes are run."""

    num_envs: int = 8
    """Scenes stepped together in a process."""
    workers: int = 1
    """Processes; 1 runs in this one."""
    seed: int = 0
    """Of torch, for policies that draw."""
    deterministic: bool = True
    """Let a stochastic policy take its mode."""
    path_key: NestedKey | None = None
    """See `run_episodes`."""
    target_key: NestedKey | None = None
    """See `run_episodes`."""
    progress: bool = True
    """Show a bar."""

    def __post_init__(self) -> None:
        for name in ("num_envs", "workers"):
            if getattr(self, name) < 1:
                raise ValueError(
                    f"EvaluationConfig: {name} must be >= 1, got {getattr(self, name)}."
                )

    @property
    def exploration(self) -> ExplorationType:
        """How a stochastic policy acts."""
        return ExplorationType.DETERMINISTIC if self.deterministic else ExplorationType.RANDOM


def evaluate(
    make_env: EnvFactory,
    policy: Policy,
    evaluation_set: EvaluationSet,
    folder: Path,
    *,
    label: str,
    config: EvaluationConfig | None = None,
    resume: bool = True,
) -> pd.DataFrame:
    """Run what is missing of a set, and return a row for each of its episodes.

    Args:
        make_env: Makes the environment, transforms included.
        policy: Acts. With several workers it is pickled.
        evaluation_set: The episodes.
        folder: Where results are kept, see `ResultStore`.
        label: Names policy and settings; a folder of another label is refused.
        config: How episodes are run.
        resume: Go on with what the folder holds.

    Returns:
        Columns `COLUMNS` of `modpush.evaluation.results`, sorted by episode.

    Raises:
        ValueError: If the folder holds another run.
        RuntimeError: If a worker fails; what has finished is kept.
    """
    config = config or EvaluationConfig()
    store = ResultStore(folder, evaluation_set, label, resume=resume)
    missing = [(n, evaluation_set.scenarios[n]) for n in store.missing()]
    run = _run_here if config.workers == 1 else _run_in_workers
    done = store.rows()["success"].tolist()
    with tqdm(
        total=len(evaluation_set),
        initial=len(done),
        unit="episode",
        desc=evaluation_set.name,
        disable=not config.progress,
    ) as bar:
        for episode in run(make_env, policy, missing, config):
            store.write(episode)
            done.append(episode.metrics.success)
            bar.set_postfix(success=f"{sum(done) / len(done):.3f}", refresh=False)
            bar.update()
    return store.rows()


def _run_here(
    make_env: EnvFactory,
    policy: Policy,
    episodes: Sequence[tuple[int, Scenario]],
    config: EvaluationConfig,
) -> Iterator[Episode]:
    if not episodes:
        return
    torch.manual_seed(config.seed)
    objects = tuple(dict.fromkeys(scenario.pushed_object for _, scenario in episodes))
    env = make_env(min(config.num_envs, len(episodes)), objects)
    try:
        yield from run_episodes(
            env,
            policy,
            episodes,
            path_key=config.path_key,
            target_key=config.target_key,
            exploration=config.exploration,
        )
    finally:
        env.close()


def _work(results: Any, *job: Any) -> None:
    torch.set_num_threads(1)  # cores are shared out among the processes
    for episode in _run_here(*job):
        results.put(episode)


def _run_in_workers(
    make_env: EnvFactory,
    policy: Policy,
    episodes: Sequence[tuple[int, Scenario]],
    config: EvaluationConfig,
) -> Iterator[Episode]:
    """Each worker takes every n-th episode. Spawned: a fork would copy numba's and torch's threads."""
    context = multiprocessing.get_context("spawn")
    results = context.Queue()
    shares = [episodes[k :: config.workers] for k in range(config.workers)]
    workers = [
        context.Process(target=_work, args=(results, make_env, policy, share, config), daemon=True)
        for share in shares
        if share
    ]
    for worker in workers:
        worker.start()
    try:
        left = len(episodes)
        while left:
            try:
                yield results.get(timeout=1.0)
                left -= 1
            except queue.Empty:
                _check_alive(workers)
    finally:
        for worker in workers:
            worker.terminate()
            worker.join()


def _check_alive(workers: Sequence[Any]) -> None:
    codes = [worker.exitcode for worker in workers]
    if any(codes):
        raise RuntimeError(
            f"evaluate: a worker ended early, exit codes {codes}; its own message is above. "
            "Finished episodes are kept; run again to go on."
        )
