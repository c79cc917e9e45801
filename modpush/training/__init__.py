"""The school: environment and learner side by side, evaluated, logged, resumable."""

from importlib import import_module
from typing import Any

_HOME = {
    "TRAIN_PRESETS": "config",
    "TrainConfig": "config",
    "Trainer": "trainer",
    "check_run_folder": "run_folder",
}

__all__ = [*sorted(_HOME)]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
