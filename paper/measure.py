"""Methods on evaluation sets, of which only the missing episodes are run."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import pandas as pd
from torchrl.envs import EnvBase

from modpush.evaluation import EvaluationConfig, EvaluationSet, evaluate, load_set
from modpush.evaluation.sets import BEHIND_SETS, EVALUATION_SETS
from modpush.recipes.methods import Method, get_method
from paper.blocks import AGENTS, WITH_THE_PAPERS_VALUES
from paper.provenance import add_session
from paper.statistics import RETRAINED
from paper.tables import CONTROLLERS

__all__ = ["FRAGMENT_AGENT", "SEED", "Running", "find_method", "measure", "run_methods"]

SEED = 20_261_122
"""Seed of scenarios that are in no set."""
FRAGMENT_AGENT = Path(__file__).parent / "agents" / f"{RETRAINED}.safetensors"
"""The agent that was trained further with the fragment; it runs on the sets with this object alone."""


@dataclass(frozen=True, kw_only=True)
class Running:
    """Settings of the episodes, and the folder of their rows and trajectories."""

    folder: Path = Path("runs/paper")
    """Folder of rows and trajectories, as `modpush evaluate --out` fills it; finished episodes are not
    run again."""
    num_envs: int = 8
    """Number of scenes that each process steps together."""
    workers: int | Literal["ray"] = 1
    """Number of processes, or `ray` for all CPUs of a Ray cluster."""
    progress: bool = True
    """Show progress bars."""


def find_method(name: str, recovery: bool | None = None) -> tuple[str, Method]:
    """A method and the name of its rows: `fragment`, what `modpush evaluate --policy` takes, or a file.

    Args:
        name: The method. An agent's file is named by its stem.
        recovery: Whether `StuckRecovery` takes over at rest; None for what the agent's config says.

    Raises:
        ValueError: If there is no such method.
    """
    if name == RETRAINED:
        return name, get_method(str(FRAGMENT_AGENT), recovery=recovery)
    method = get_method(name, recovery=recovery)
    return (Path(name).stem if Path(name).is_file() else method.name), method


def run_methods(
    running: Running,
    methods: tuple[str, ...] = (*AGENTS, WITH_THE_PAPERS_VALUES, RETRAINED, *CONTROLLERS),
    sets: tuple[str, ...] = (*EVALUATION_SETS, *BEHIND_SETS),
    first: int | None = None,
) -> None:
    """Run methods on the evaluation sets.

    Args:
        running: How episodes are run.
        methods: What `modpush evaluate --policy` takes, or `fragment`, the agent that was
            trained further with the fragment.
        sets: Names of the sets.
        first: Number of episodes of each set, starting with its first; all by default.

    Raises:
        ValueError: If there is no such method or set, before an episode is run.
    """
    found = dict(find_method(method) for method in methods)
    episodes = [load_set(name).first(first) for name in sets]
    for name, method in found.items():
        for evaluation_set in episodes:
            if name != RETRAINED or evaluation_set.objects == (RETRAINED,):
                measure(
                    method, evaluation_set, running.folder / name / evaluation_set.name, running
                )


def measure(
    method: Method,
    episodes: EvaluationSet,
    folder: Path,
    running: Running,
    *,
    make_env: Callable[..., EnvBase] | None = None,
    label: str = "",
) -> pd.DataFrame:
    """Run the missing episodes of a method on a set, and note commit and machine in the folder.

    Args:
        method: The method.
        episodes: The episodes.
        folder: Folder of its rows and trajectories.
        running: How episodes are run.
        make_env: As in `evaluate`; by default the method's.
        label: Text that tells these results from others of the same policy and episodes.

    Returns:
        A row for each episode.
    """
    path = folder / "episodes.csv"
    if not path.exists() or path.read_bytes().count(b"\n") <= len(episodes):
        add_session(folder)
    return evaluate(
        method.make_policy(),
        episodes,
        folder,
        make_env=make_env or method.make_env,
        label=label,
        config=EvaluationConfig(
            num_envs=running.num_envs,
            workers=running.workers,
            progress=running.progress,
            path_key=method.path_key,
            target_key=method.target_key,
        ),
    )
