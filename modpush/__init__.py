"""Learning to push objects through clutter: parts that fit into any TorchRL pipeline.

Import what you need from its room: `modpush.envs`, `modpush.planners`, `modpush.encoders`,
`modpush.agents`, `modpush.replay`, `modpush.evaluation`, `modpush.training`. Importing `modpush` itself
is free; `load_agent` and `make_push_env` bring in all rooms on first use.
"""

from typing import Any

__version__ = "0.1.0"

__all__ = ["__version__", "load_agent", "make_push_env"]


def __getattr__(name: str) -> Any:
    if name not in ("load_agent", "make_push_env"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from modpush import paper

    return getattr(paper, name)
