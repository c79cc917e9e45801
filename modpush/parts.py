"""Your own parts: given by name, by `"module:name"`, or as the object itself.

Every place that takes a part (a scene, a planner, an encoder, a reward term, ...) looks it up with
`find_part`, so that the three ways work everywhere alike. Text is what a configuration file and the
command line can hold; `part_name` is the inverse.

Whatever comes from a file is data. What a user types or passes is imported as it is; every reader of a
file passes the text that may name parts through `check_allowed`, before anything is made of it.
"""

import inspect
from collections.abc import Collection, Iterator, Mapping
from importlib import import_module
from types import ModuleType
from typing import Any

_LIBRARY = (
    "modpush.agents",
    "modpush.encoders",
    "modpush.envs",
    "modpush.mdp",
    "modpush.planners",
    "modpush.replay",
)
"""The library's packages of parts, from which every file may name them."""


class ModulesRefusedError(ValueError):
    """A file names parts in modules that its reader has not agreed to import."""


def find_part(name: str, part: Any, known: Mapping[str, Any], kind: type | None = None) -> Any:
    """The part that a name, a `"module:name"` or an object stands for.

    Args:
        name: Name of the argument, for errors: `"planner"`.
        part: A name in `known`; `"module:name"`, which is imported (`name` may have dots); or
            anything that is not text, which is returned as it is.
        known: The parts that the library brings, by name.
        kind: Class that the part must be of.

    Raises:
        ValueError: If there is no part of that name (the known ones are listed), if the module cannot be
            imported, has no such attribute, or if the part is of another class.
    """
    found = part
    if isinstance(part, str) and part in known:
        found = known[part]
    elif isinstance(part, str):
        if part_module(part) is None:
            raise ValueError(
                f"{name}: there is no {part!r}, expected one of {sorted(known)}, or 'module:name' for "
                "a part of your own."
            )
        *_, found = _walk(name, part)
    if kind is not None and not isinstance(found, kind):
        source = f" from {part!r}" if isinstance(part, str) else ""
        raise ValueError(f"{name} must be a {kind.__name__}, got a {type(found).__name__}{source}.")
    return found


def _walk(place: str, part: str) -> Iterator[Any]:
    """Objects on the way of a `"module:name"`, from the module's attribute to the part itself."""
    module, _, name = part.partition(":")
    try:
        found: Any = import_module(module)
    except ImportError as error:
        raise ValueError(
            f"{place}: cannot import {module!r} for {part!r}: {error}. A module is "
            "found if it is installed or in a folder of PYTHONPATH; for the current folder, PYTHONPATH=."
        ) from error
    for attribute in name.split("."):
        if not hasattr(found, attribute):
            raise ValueError(
                f"{place}: {part!r} not found: {found!r} has no attribute {attribute!r}."
            )
        found = getattr(found, attribute)
        yield found


def part_name(name: str, part: Any, known: Mapping[str, Any]) -> str:
    """The text by which `find_part` finds this part again, for configuration files.

    Raises:
        ValueError: If no text does: a lambda, or something that is defined inside a function or in the
            script that is being run.
    """
    if isinstance(part, str):
        find_part(name, part, known)
        return part
    for known_name, value in known.items():
        if value is part:
            return known_name
    module, own = getattr(part, "__module__", None), getattr(part, "__qualname__", None)
    if module is not None and own is not None and module != "__main__" and "<" not in own:
        return f"{module}:{own}"
    raise ValueError(
        f"{name}: {part!r} cannot be written to a file, since nothing says how to import it. Define "
        "it at the top level of a module and give it as 'module:name'."
    )


def check_part(
    name: str,
    part: Any,
    known: Collection[str],
    kind: type | None = None,
    other: str = "'module:name'",
) -> None:
    """Refuse what stands for no part, without importing anything.

    That is one of the known names, a `"module:name"`, or an object of a class (a function without
    `kind`); `other` describes the latter two in the error.
    """
    if isinstance(part, str):
        good = part in known or part_module(part) is not None
    else:
        good = callable(part) if kind is None else isinstance(part, kind)
    if not good:
        own = "" if kind is None else f" or a {kind.__name__}"
        raise ValueError(f"{name} must be one of {sorted(known)} or {other}{own}, got {part!r}.")


def part_module(part: Any) -> str | None:
    """The module that `find_part` would import for a `"module:name"`; None for anything else."""
    if not isinstance(part, str):
        return None
    module, _, name = part.partition(":")
    names = [*module.split("."), *name.split(".")]
    return module if all(map(str.isidentifier, names)) else None


def modules_named(data: Any) -> set[str]:
    """The modules of all `"module:name"` in a config as plain data: keys and values, however deep."""
    return {text.partition(":")[0] for text in parts_named(data)}


def parts_named(data: Any) -> set[str]:
    """All `"module:name"` in a config as plain data: keys and values, however deep."""
    return {text for text in _texts(data) if part_module(text) is not None}


def _texts(data: Any) -> set[str]:
    """All text in plain data; without recursion, since a file may be nested as deeply as it likes."""
    found, waiting = set(), [data]
    while waiting:
        item = waiting.pop()
        if isinstance(item, str):
            found.add(item)
        elif isinstance(item, Mapping):
            waiting += [*item, *item.values()]
        elif isinstance(item, list | tuple):
            waiting += item
    return found


def check_allowed(source: str, data: Any, allow: Collection[str] = ()) -> None:
    """The gate between a file's data and code.

    A file must never decide which code is run: what it names is imported only if it is one of the
    library's parts, or in a module that the caller has allowed. There it must be defined: a name that
    a module has imported from elsewhere, or that leads through another module, is refused, too.

    Args:
        source: Reader and file, for errors.
        data: The part of a file's content that may name parts, as plain data.
        allow: Modules and packages from which the caller agrees to import; or single parts,
            `"module:name"`, that the caller has named himself.

    Raises:
        TypeError: If `allow` is not of texts.
        ModulesRefusedError: If the data name anything else; nothing has been imported from there.
        ValueError: If a part cannot be imported.
    """
    allowed = (*_LIBRARY, *allow)
    parts = parts_named(data) - {*allow}
    if refused := sorted(m for m in modules_named([*parts]) if not _is_within(m, allowed)):
        raise ModulesRefusedError(
            f"{source}: the file names parts in {refused}, which are imported only if you say so: "
            f"pass allow={tuple(refused)!r}, or the parts themselves; on the command line, "
            f"--allow {' '.join(refused)}."
        )
    for text in sorted(parts):
        for step in _walk(source, text):
            home = _home(step)
            if home is not None and not _is_within(home, allowed):
                raise ModulesRefusedError(
                    f"{source}: the file names {text!r}, which leads to {step!r} of {home!r}; expected "
                    "something that is defined in its own module, or allow that module, too."
                )


def _is_within(module: str, allowed: Collection[str]) -> bool:
    return any(module == name or module.startswith(f"{name}.") for name in allowed)


def _home(found: Any) -> str | None:
    """The module in which a module, class or function is defined; None for any other object."""
    if isinstance(found, ModuleType):
        return f"the module {found.__name__}"
    if inspect.isclass(found) or inspect.isroutine(found):
        return str(found.__module__)
    return None
