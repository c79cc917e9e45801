"""The engines by name."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from modpush._extras import require_extra
from modpush.envs.engines.base import EngineFactory
from modpush.parts import find_part, part_module


@dataclass(frozen=True, kw_only=True)
class ShippedEngine:
    """An engine of the library; nothing of it is imported before it is used."""

    factory: str
    """Its factory, as `module:name`."""
    sim_freq: int
    """Physics steps per second at which it is accurate enough [Hz]."""
    packages: tuple[str, ...] = ()
    """Packages that it needs and that an extra brings."""


ENGINES: dict[str, ShippedEngine] = {
    "sapien": ShippedEngine(
        factory="modpush.envs.engines.sapien.engine:SapienEngine.build", sim_freq=120
    ),
    "mujoco": ShippedEngine(
        factory="modpush.envs.engines.mujoco.engine:MujocoEngine",
        sim_freq=480,
        packages=("mujoco",),
    ),
}
"""The shipped engines by name."""


def check_engine(who: str, engine: Any) -> None:
    """Refuse what cannot be an engine, without importing anything.

    Args:
        who: What has the engine, for the error message.
        engine: A name, `"module:name"`, or something that can be called.

    Raises:
        ValueError: If it is none of them; the message lists the known names.
    """
    if not (engine in [*ENGINES] or callable(engine) or part_module(engine) is not None):
        raise ValueError(
            f"{who}: engine must be one of {[*ENGINES]}, 'module:name', or an Engine's class or "
            f"function, got {engine!r}."
        )


def find_engine(engine: str | EngineFactory) -> EngineFactory:
    """Factory of an engine's scenes, by name, by `"module:name"`, or passed through.

    Raises:
        ValueError: If there is no such engine (the known ones are listed), or if it cannot be called.
        MissingExtraError: If a package is not installed that the engine needs; the message names it.
    """
    found: Any = find_part("engine", engine, ENGINES)
    if isinstance(found, ShippedEngine):
        require_extra(f"PushEnv: engine {engine!r}", *found.packages)
        found = find_part("engine", found.factory, {})
    if not callable(found):
        raise ValueError(
            "PushEnv: engine must be an Engine's class or a function (spec) -> Engine, got "
            f"{found!r}."
        )
    return found


def default_sim_freq(engine: str | EngineFactory, factory: Callable[..., Any]) -> int:
    """Physics steps per second of an engine where none are given [Hz].

    Args:
        engine: The engine as it was given.
        factory: What `find_engine` has found.

    Raises:
        ValueError: If a function was given, which has no rate of its own.
    """
    if isinstance(engine, str) and engine in ENGINES:
        return ENGINES[engine].sim_freq
    rate = getattr(factory, "default_sim_freq", None)
    if rate is None:
        raise ValueError(
            f"PushEnv: sim_freq must be given with the engine {engine!r}, which has no "
            "default_sim_freq, got None."
        )
    return int(rate)
