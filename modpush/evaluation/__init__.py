"""From a policy to tables and pictures. Needs no simulator: environments come from the caller."""

from importlib import import_module
from typing import Any

_HOME = {
    "Episode": "episodes",
    "EpisodeMetrics": "metrics",
    "EvaluationConfig": "runner",
    "EvaluationSet": "sets",
    "ResultStore": "results",
    "SET_NAMES": "sets",
    "Trajectory": "episodes",
    "bootstrap_interval": "stats",
    "compare": "tables",
    "episode_metrics": "metrics",
    "evaluate": "runner",
    "format_table": "tables",
    "generate_set": "sets",
    "load_set": "sets",
    "paired_t_test": "stats",
    "run_episodes": "episodes",
    "shortest_path": "shortest",
    "summarize": "tables",
    "to_display": "tables",
}

__all__ = [*sorted(_HOME)]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
