"""A policy over an evaluation set: batched, resumable, in one process or several."""

import functools
import inspect
import math
import multiprocessing
import queue
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import pandas as pd
import torch
from annotated_types import Le
from torchrl.envs import EnvBase
from torchrl.envs.utils import ExplorationType
from tqdm import tqdm

from modpush._atomic import FolderLock
from modpush._processes import RESTARTS, begin_worker_process, ray_session, torch_threads
from modpush._types import Count, Key, Scenes, Seed
from modpush._validation import checked, checked_arguments
from modpush.envs.scenes.conditions import EpisodeConditions, SensingConfig
from modpush.envs.scenes.scenario import Scenario
from modpush.evaluation.episodes import Episode, Policy, run_episodes
from modpush.evaluation.results import SET_FILE, ResultStore, describe_policy
from modpush.evaluation.sets import SET_NAMES, EvaluationSet, load_set

_MAX_WAYPOINTS = 32  # of the first planned path, for pictures

EnvFactory = Callable[..., EnvBase]
"""`(number of scenes, names of the objects that will be pushed) -> environment`, in which time limit,
tool and physics are those of the set. One that has a parameter `conditions` is given the set's
`EpisodeConditions`. With several workers it must be picklable: a function of a module, or a
`functools.partial` of one."""


@checked
class EvaluationConfig:
    """Settings with which episodes are run."""

    num_envs: Scenes = 8
    """Number of scenes stepped together in each process."""
    workers: Annotated[Count, Le(256)] | Literal["ray"] = 1
    """Number of processes; 1 runs in this one. With `"ray"` there is one for each CPU of the Ray cluster
    that is found, or else of this machine."""
    seed: Seed = 0
    """Seed of torch, for policies that draw random numbers."""
    deterministic: bool = True
    """Let a stochastic policy take its most likely action."""
    path_key: Key | None = None
    """Key of the planned path, see `run_episodes`."""
    target_key: Key | None = None
    """Key of the sub-goal on which the policy acts, see `run_episodes`."""
    progress: bool = True
    """Show a progress bar."""
    threads: Count = 1
    """Number of torch's threads in each process while episodes run. Sums are rounded differently with
    another number."""


@checked_arguments
def evaluate(
    policy: Any,
    evaluation_set: EvaluationSet | str | Path,
    folder: Path | str,
    *,
    make_env: EnvFactory | None = None,
    label: str = "",
    config: EvaluationConfig | None = None,
    resume: bool = True,
) -> pd.DataFrame:
    """Run the missing episodes of a set, and return a row for each of its episodes.

    Args:
        policy: Policy to evaluate: a `Policy`; or a result of `modpush.load_agent` or
            `modpush.recipes.get_method`, which know their environment. With several workers it is
            pickled.
        evaluation_set: The episodes, or their name or file as for `load_set`.
        folder: Folder in which results are stored, see `ResultStore`.
        make_env: Makes the environment, transforms included; needed unless an agent is given, whose
            environment gets the set's conditions.
        label: Text that distinguishes this policy's settings from others, if neither weights nor a
            `config` do.
        config: Settings with which episodes are run.
        resume: Continue with what the folder holds.

    Returns:
        Columns `COLUMNS` of `modpush.evaluation.results`, sorted by episode.

    Raises:
        KeyboardInterrupt: After Ctrl-C, with a message that says what is kept.
        ValueError: If the folder holds results of another policy (told by its class, weights, config
            and label, and your own also by the source of its module) or another set, there is nothing
            to make the environment with, or its time limit, tool or physics are not the set's.
        RuntimeError: If a worker fails; finished episodes are kept.
        FolderLockedError: If another process writes to the folder; the message says which.
    """
    config = config or EvaluationConfig()
    if not isinstance(evaluation_set, EvaluationSet):
        evaluation_set = load_set(evaluation_set)
    acting, make_env, config = _with_environment(policy, make_env, config)
    if not callable(acting):
        raise TypeError(f"evaluate: policy must be a function, got {acting!r}.")
    about = describe_policy(acting, label)
    if not config.deterministic:  # such actions differ from the greedy ones, and between seeds
        about = {**about, "deterministic": False, "seed": config.seed}
    if resume and (finished := _finished(Path(folder), evaluation_set, about)) is not None:
        return finished
    with FolderLock(folder), torch_threads(config.threads):
        store = ResultStore(folder, evaluation_set, about, resume=resume)
        if evaluation_set.name not in SET_NAMES:
            evaluation_set.save(Path(folder) / SET_FILE)  # nothing else says later what was run
        missing = [(n, evaluation_set.scenarios[n]) for n in store.missing()]
        job = _Job(make_env, acting, missing, config, evaluation_set.conditions)
        run = {1: _run_here, "ray": _run_on_cluster}.get(config.workers, _run_in_workers)
        done = store.rows()["success"].tolist()
        with tqdm(
            total=len(evaluation_set),
            initial=len(done),
            unit="episode",
            desc=evaluation_set.name,
            disable=not config.progress,
        ) as bar:
            try:
                for episode in run(job) if missing else ():
                    store.write(episode)
                    done.append(episode.metrics.success)
                    bar.set_postfix(success=f"{sum(done) / len(done):.3f}", refresh=False)
                    bar.update()
            except KeyboardInterrupt:
                raise KeyboardInterrupt(
                    f"Stopped; {len(store.rows())} of {len(evaluation_set)} episodes are in {folder}. "
                    "The same again continues with the others."
                ) from None
        return store.rows()


def _with_environment(
    policy: Any, make_env: EnvFactory | None, config: EvaluationConfig
) -> tuple[Policy, EnvFactory, EvaluationConfig]:
    """Policy, environment factory, and config with the keys that the policy writes."""
    if hasattr(policy, "make_policy"):  # a `Method`
        make_env, keys = make_env or policy.make_env, (policy.path_key, policy.target_key)
        policy = policy.make_policy()
    elif make_env is None and hasattr(policy, "make_env"):  # an `Agent`
        make_env, keys = functools.partial(_agent_env, policy), ("path", "subgoal")
    elif make_env is None:
        raise ValueError(
            "evaluate: make_env is needed for a policy that is neither an agent of load_agent nor a "
            f"method of get_method, got {type(policy).__name__}. get_method(policy) gives a function an "
            "environment with a planner."
        )
    else:
        keys = (None, None)
    path_key, target_key = config.path_key or keys[0], config.target_key or keys[1]
    config = replace(config, path_key=path_key, target_key=target_key)
    if hasattr(policy, "make_env"):  # a module of one's own may call what it wraps `policy`, too
        policy = policy.policy
    return policy, make_env, config


def _finished(
    folder: Path, evaluation_set: EvaluationSet, about: dict[str, Any]
) -> pd.DataFrame | None:
    """The rows of a folder that holds all of them, which is only read; it may lie on a read-only disk."""
    if not (folder / "run.json").exists() or not (folder / "episodes.csv").exists():
        return None
    if not (folder / "episodes.csv").read_bytes().endswith(b"\n"):
        return None
    store = ResultStore(folder, evaluation_set, about)
    return None if store.missing() else store.rows()


def _agent_env(
    agent: Any, num_envs: int, objects: Sequence[str], conditions: EpisodeConditions
) -> EnvBase:
    return agent.make_env(
        num_envs,
        pushed_object=tuple(objects),
        max_waypoints=_MAX_WAYPOINTS,
        **conditions.agent_options(agent.config.inflation),
    )


def _make_env(
    factory: EnvFactory, num_envs: int, objects: Sequence[str], conditions: EpisodeConditions
) -> EnvBase:
    """The environment that a factory makes, if it is as the set says."""
    takes = "conditions" in inspect.signature(factory).parameters
    if not takes and conditions.sensing != SensingConfig():
        raise ValueError(
            "evaluate: make_env must have a parameter `conditions`, in which sensing is "
            f"{conditions.sensing}."
        )
    env = factory(num_envs, objects, **({"conditions": conditions} if takes else {}))
    simulation = getattr(env, "simulation", None)
    if simulation is None or not (differences := conditions.differences(simulation)):
        return env
    env.close()
    raise ValueError(
        f"evaluate: the environment must have the set's conditions, (environment, set): {differences}. "
        "Give make_env a parameter `conditions`, and pass its `env_options` to PushEnv."
    )


class _Job(NamedTuple):
    """Episodes that are to be run, and how."""

    make_env: EnvFactory
    policy: Policy
    episodes: Sequence[tuple[int, Scenario]]
    config: EvaluationConfig
    conditions: EpisodeConditions


def _run_on_cluster(job: _Job) -> Iterator[Episode]:
    """Run episodes in as many tasks at a time as the Ray cluster has CPUs."""
    with ray_session("evaluate: workers='ray'", 1) as ray:
        # Several tasks for each CPU, so that none waits long for the others.
        tasks = 4 * int(ray.cluster_resources()["CPU"])
        size = max(job.config.num_envs, math.ceil(len(job.episodes) / tasks))
        shares = [job.episodes[k : k + size] for k in range(0, len(job.episodes), size)]
        run = ray.remote(num_cpus=1, max_retries=RESTARTS)(_run_share)
        left = [run.remote(job._replace(episodes=share)) for share in shares]
        while left:
            (done, *_), left = ray.wait(left)
            yield from ray.get(done)


def _run_share(job: _Job) -> list[Episode]:
    torch.set_num_threads(1)  # a task has one CPU
    return list(_run_here(job))


def _run_here(job: _Job) -> Iterator[Episode]:
    torch.manual_seed(job.config.seed)
    # As many scenes as ever, however few episodes are left: the last bits of a network's outputs, and
    # with them the course of an episode, depend on the number of rows in its matrix products.
    objects = tuple(dict.fromkeys(scenario.pushed_object for _, scenario in job.episodes))
    env = _make_env(job.make_env, job.config.num_envs, objects, job.conditions)
    try:
        yield from run_episodes(
            env,
            job.policy,
            job.episodes,
            inflation=job.conditions.inflation,
            path_key=job.config.path_key,
            target_key=job.config.target_key,
            exploration=ExplorationType.DETERMINISTIC
            if job.config.deterministic
            else ExplorationType.RANDOM,
        )
    finally:
        env.close()


def _work(results: Any, job: _Job) -> None:
    begin_worker_process()
    with torch_threads(job.config.threads):
        for episode in _run_here(job):
            results.put(episode)


def _run_in_workers(job: _Job) -> Iterator[Episode]:
    """Each worker takes every n-th episode. Spawned: a fork would copy numba's and torch's threads."""
    context = multiprocessing.get_context("spawn")
    results, count = context.Queue(), job.config.workers
    assert count != "ray"
    shares = [job._replace(episodes=job.episodes[k::count]) for k in range(count)]
    workers = [
        context.Process(target=_work, args=(results, share), daemon=True)
        for share in shares
        if share.episodes
    ]
    for worker in workers:
        worker.start()
    try:
        left, ended = len(job.episodes), False
        while left:
            try:
                yield results.get(timeout=1.0)
                left -= 1
            except queue.Empty:
                codes = [worker.exitcode for worker in workers]
                if any(codes) or ended:
                    raise RuntimeError(
                        f"evaluate: a worker ended early, exit codes {codes}; its own message is above. "
                        "Finished episodes are kept; run again to continue."
                    ) from None
                ended = None not in codes  # their last episodes may still be on the way
    finally:
        for worker in workers:
            worker.kill()
            worker.join()
