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
from modpush.recipes.agent_file import shipped_agents
from modpush.recipes.methods import Method, get_method
from modpush.reproduction.config import ReproduceConfig

__all__ = ["AGENT", "Measured", "agent_source", "measure", "measure_policy", "methods_for"]

AGENT = "agent"
"""Name of the agent that is evaluated everywhere."""
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


def agent_source(name: str) -> str:
    """What `get_method` takes for a shipped agent's name; any other text is passed through."""
    return str(shipped_agents().get(name, name))


def methods_for(config: ReproduceConfig, pushed_object: str) -> dict[str, Method]:
    """The methods that are compared on an object: the agent, one of the object's own, the controllers.

    Raises:
        ValueError: If there is no such agent.
    """
    sources = {AGENT: agent_source(config.agent)}
    if pushed_object in config.policy_files:
        sources["agent_retrained"] = str(config.policy_files[pushed_object])
    sources |= {name: name for name in _CONTROLLERS}
    return {name: get_method(source, allow=config.allow) for name, source in sources.items()}


def measure(
    name: str, method: Method, evaluation_set: EvaluationSet, config: ReproduceConfig
) -> Measured:
    """Run what is missing of a method on the first episodes of a set.

    Args:
        name: Name of the method, for its folder.
        method: The method.
        evaluation_set: The whole set.
        config: How many episodes, and where rows are kept.
    """
    return measure_policy(
        method.make_policy(),
        evaluation_set.first(config.first),
        config.rows / "sets" / name / evaluation_set.name,
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
    if (new := _count(folder) - before) > 0:
        add_session(folder, new, time.perf_counter() - began)
    return Measured(rows=rows, folder=folder, sessions=read_sessions(folder))


def _count(folder: Path) -> int:
    """Number of rows that a folder holds."""
    path = folder / "episodes.csv"
    return max(0, path.read_bytes().count(b"\n") - 1) if path.exists() else 0
