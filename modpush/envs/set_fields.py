"""`set_fields`: single fields of several configurations, by name."""

from collections.abc import Iterable, Mapping
from dataclasses import fields, replace
from typing import Any


def set_fields(
    caller: str, given: Mapping[str, Any], *configs: Any, also: Iterable[str] = ()
) -> list[Any]:
    """Configurations with single fields replaced; each name goes to the first that has such a field.

    By this `PushEnv`, `PushEnvConfig`, `make_push_env` and `gymnasium.make` understand `scene="slot"`.
    Another engine without a rate gets its own: `engine` sets `sim_freq` to None, too.

    Returns:
        The configurations in their order; those of which nothing is replaced are the same objects.

    Raises:
        TypeError: If none of them has a field of a given name; the message lists all, and those of
        `also`.
    """
    names = [{field.name for field in fields(config)} for config in configs]
    known = set().union(*names)
    # GymEnv parses the standard TypeError text to find out what an environment does not take.
    if unknown := ", ".join(repr(name) for name in sorted(set(given) - known)):
        raise TypeError(
            f"{caller}: got an unexpected keyword argument {unknown}; expected some of "
            f"{sorted({*known, *also})}."
        )
    changed, left = [], dict(given)
    for config, own in zip(configs, names, strict=True):
        mine = {name: left.pop(name) for name in own & left.keys()}
        if "engine" in mine and mine["engine"] != config.engine:
            mine.setdefault("sim_freq", None)
        changed.append(replace(config, **mine) if mine else config)
    return changed
