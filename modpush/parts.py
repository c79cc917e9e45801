"""Your own parts: given by name, by `"module:name"`, or as the object itself.

Every place that takes a part (a scene, a planner, an encoder, a reward term, ...) looks it up with
`find_part`, so that the three ways work everywhere alike. Text is what a configuration file and the
command line can hold; `part_name` is the inverse.
"""

from collections.abc import Collection, Iterable, Mapping
from importlib import import_module
from typing import Any

from modpush._checks import check_texts

__all__ = [
    "ModulesRefusedError",
    "check_allowed",
    "find_part",
    "modules_named",
    "part_module",
    "part_name",
]


class ModulesRefusedError(ValueError):
    """A file names parts in modules that its reader has not agreed to import."""


def find_part(who: str, part: Any, known: Mapping[str, Any]) -> Any:
    """The part that a name, a `"module:name"` or an object stands for.

    Args:
        who: Name of the caller, for error messages: `"make_push_env: planner"`.
        part: A name in `known`; `"module:name"`, which is imported (`name` may have dots); or
            anything that is not text, which is returned as it is.
        known: The parts that the library brings, by name.

    Raises:
        ValueError: If there is no part of that name (the known ones are listed), if the module cannot be
            imported, or has no such attribute.
    """
    if not isinstance(part, str):
        return part
    if part in known:
        return known[part]
    module, colon, name = part.partition(":")
    if not (colon and module and name):
        raise ValueError(
            f"{who}: there is no {part!r}, expected one of {sorted(known)}, or 'module:name' for "
            "a part of your own."
        )
    try:
        found: Any = import_module(module)
    except ImportError as error:
        raise ValueError(f"{who}: cannot import {module!r} for {part!r}: {error}.") from error
    for attribute in name.split("."):
        if not hasattr(found, attribute):
            raise ValueError(f"{who}: {part!r} names nothing: {found!r} has no {attribute!r}.")
        found = getattr(found, attribute)
    return found


def part_name(who: str, part: Any, known: Mapping[str, Any]) -> str:
    """The text by which `find_part` finds this part again, for configuration files.

    Args:
        who: Name of the caller, for error messages.
        part: A part; text is checked and returned.
        known: The parts that the library brings, by name.

    Raises:
        ValueError: If the part cannot be found by any text: a lambda, or something that is defined
            inside a function or in the script that is being run.
    """
    if isinstance(part, str):
        find_part(who, part, known)
        return part
    for known_name, value in known.items():
        if value is part:
            return known_name
    module, name = getattr(part, "__module__", None), getattr(part, "__qualname__", None)
    if module is not None and name is not None and module != "__main__" and "<" not in name:
        return f"{module}:{name}"
    raise ValueError(
        f"{who}: {part!r} cannot be written to a file, since nothing says how to import it. Define "
        "it at the top level of a module and give it as 'module:name'."
    )


def part_module(part: Any) -> str | None:
    """The module that a `"module:name"` would import; None for anything else."""
    if not isinstance(part, str) or ":" not in part:
        return None
    return part.partition(":")[0]


def modules_named(data: Any) -> set[str]:
    """The modules of all `"module:name"` in a config as plain data: keys and values, however deep."""
    if isinstance(data, Mapping):
        data = [*data, *data.values()]
    if isinstance(data, (list, tuple)):
        return set().union(*map(modules_named, data))
    module = part_module(data)
    return set() if module is None else {module}


def check_allowed(who: str, modules: Iterable[str], allow: Collection[str]) -> None:
    """Refuse modules that are not modpush's and that the caller has not named.

    A file must never decide what code is run: what it names is imported only if the caller agrees.

    Raises:
        TypeError: If `allow` is not of texts.
        ModulesRefusedError: If a module is neither in `allow` nor inside a package that is.
    """
    check_texts(who, "allow", allow)
    allowed = ("modpush", *allow)
    refused = sorted(
        {m for m in modules if not any(m == a or m.startswith(f"{a}.") for a in allowed)}
    )
    if refused:
        raise ModulesRefusedError(
            f"{who}: the file names parts in {refused}, which are imported only if you say so: "
            f"pass allow={tuple(refused)!r}, or the parts themselves; on the command line, "
            f"--allow {' '.join(refused)}."
        )
