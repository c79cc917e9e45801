"""Rows of a method on an evaluation set, of which only the missing ones are run."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase

from modpush._provenance import Session, add_session, forget_sessions, read_sessions
from modpush.evaluation.runner import EvaluationConfig, evaluate
from modpush.evaluation.sets import EvaluationSet
from modpush.recipes.methods import Method, get_method
from modpush.reproduction.config import ReproduceConfig

__all__ = [
    "AGENT",
    "RETRAINED",
    "Measured",
    "agent_method",
    "measure",
    "measure_policy",
    "methods_for",
]

AGENT = "agent"
"""Name of the agent that is evaluated everywhere."""
RETRAINED = "agent_retrained"
"""Name of the agent that `policy_files` names for an object."""
_CONTROLLERS = ("corridor", "corridor_faithful")


@dataclass(frozen=True, kw_only=True)
class Measured:
    """Rows of a method on a set, and where they come from."""

    rows: pd.DataFrame
    """A row for each episode."""
    folder: Path
    """Folder of rows and trajectories."""
    sessions: list[Session]
    """When they were measured."""


def agent_method(config: ReproduceConfig) -> Method:
    """The agent that is evaluated everywhere.

    Raises:
        ValueError: If there is no such agent.
    """
    return get_method(config.agent, allow=config.allow, recovery=config.recovery)


def methods_for(config: ReproduceConfig, pushed_object: str) -> dict[str, Method]:
    """The methods that are compared on an object: the agent, one of the object's own, the controllers.

    Raises:
        ValueError: If there is no such agent.
    """
    methods = {AGENT: agent_method(config)}
    if pushed_object in config.policy_files:
        source = str(config.policy_files[pushed_object])
        methods[RETRAINED] = get_method(source, allow=config.allow, recovery=config.recovery)
    return methods | {name: get_method(name) for name in _CONTROLLERS}


def measure(method: Method, evaluation_set: EvaluationSet, config: ReproduceConfig) -> Measured:
    """Run what is missing of a method on the first episodes of a set.

    Args:
        method: The method; rows are kept by its name, so that several agents can be compared.
        evaluation_set: The whole set.
        config: How many episodes, and where rows are kept.
    """
    return measure_policy(
        method.make_policy(),
        evaluation_set.first(config.first),
        config.rows / "sets" / method.name / evaluation_set.name,
        config,
        make_env=method.make_env,
        path_key=method.path_key,
        target_key=method.target_key,
    )


def measure_policy(
    policy: TensorDictModuleBase,
    episodes: EvaluationSet,
    folder: Path,
    config: ReproduceConfig,
    *,
    make_env: Callable[..., EnvBase],
    label: str = "",
    **keys: Any,
) -> Measured:
    """The same for a policy and a factory of environments.

    Args:
        policy: What acts.
        episodes: The episodes to run.
        folder: Folder of rows and trajectories.
        config: How episodes are run.
        make_env: As in `evaluate`.
        label: Text that tells these results from others of the same policy and episodes.
        **keys: `path_key` and `target_key`, see `EvaluationConfig`.
    """
    if config.fresh:
        forget_sessions(folder)
    before = 0 if config.fresh else _count(folder)
    began = time.perf_counter()
    try:
        rows = evaluate(
            policy,
            episodes,
            folder,
            make_env=make_env,
            label=label,
            config=EvaluationConfig(
                num_envs=config.num_envs, workers=config.workers, progress=config.progress, **keys
            ),
            resume=not config.fresh,
        )
    finally:  # rows of an interrupted run are kept as well
        if (new := _count(folder) - before) > 0:
            add_session(folder, new, time.perf_counter() - began, config.workers)
    return Measured(rows=rows, folder=folder, sessions=read_sessions(folder))


def _count(folder: Path) -> int:
    """Number of rows that a folder holds."""
    path = folder / "episodes.csv"
    return max(0, path.read_bytes().count(b"\n") - 1) if path.exists() else 0
