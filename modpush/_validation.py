"""Classes that check their fields, by one mechanism: pydantic's dataclasses.

`checked` makes a frozen dataclass whose fields are checked against their annotations, such as the
types of `modpush._types`, when one is made, replaced or read from a file. `from_plain` reads one from
what JSON and YAML hold, `check_value` checks an argument of a function in the same way. Conditions
between fields stay in a class's own `__post_init__`. All errors are put into words here, those of
`modpush._arguments` too, which checks the arguments of functions.
"""

import dataclasses
import functools
import inspect
import json
import operator
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, TypeVar, dataclass_transform, overload

from pydantic import ConfigDict, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass as pydantic_dataclass

__all__ = ["check_value", "checked", "from_plain", "plain_signature"]

T = TypeVar("T")

_CONFIG = ConfigDict(strict=True, extra="forbid", arbitrary_types_allowed=True)


@overload
def checked(cls: type[T]) -> type[T]: ...
@overload
def checked(*, kw_only: bool = True) -> Callable[[type[T]], type[T]]: ...
@dataclass_transform(
    frozen_default=True, kw_only_default=True, field_specifiers=(dataclasses.field,)
)
def checked(cls: type[T] | None = None, *, kw_only: bool = True) -> Any:
    """Make a frozen dataclass of a class, which checks its fields when one is made.

    True is not a number and "3" is not 3; a whole number does for a float, a list for a tuple.

    Args:
        cls: The class, as a decorator gets it.
        kw_only: Take the fields by keyword only.

    Returns:
        The class. Making one raises a ValueError that names class and field, what came and what was
        expected; and a TypeError for unknown and missing fields, as Python does.
    """
    if cls is None:
        return functools.partial(checked, kw_only=kw_only)
    made: Any = pydantic_dataclass(cls, frozen=True, kw_only=kw_only, config=_CONFIG)
    init, names = made.__init__, _field_names(made)

    @functools.wraps(init)
    def checking_init(self: Any, *args: Any, **kwargs: Any) -> None:
        given = {**dict(zip(names, args, strict=False)), **kwargs}
        if not kw_only and len(given) == len(args) + len(kwargs):
            args, kwargs = (), given  # so that errors name the field
        try:
            init(self, *args, **kwargs)
        except ValidationError as error:
            misused = all(
                problem["type"] in _MISUSES and len(problem["loc"]) == 1
                for problem in error.errors()
            )
            text = _describe(made.__name__, error, given, names)
            raise (TypeError if misused else ValueError)(text) from None

    made.__init__ = checking_init
    made.__signature__ = plain_signature(made)
    return made


def plain_signature(function: Callable[..., Any]) -> inspect.Signature:
    """The signature that editors show: `k: float = 4`, without the conditions that are checked."""
    signature = inspect.signature(function)
    parameters = [
        parameter.replace(annotation=_plain_type(parameter.annotation))
        for parameter in signature.parameters.values()
    ]
    return signature.replace(
        parameters=parameters, return_annotation=_plain_type(signature.return_annotation)
    )


def _plain_type(kind: Any) -> Any:
    """A type without `Annotated`, also inside of others."""
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if origin is Annotated:
        return _plain_type(inner[0])
    items = tuple(_plain_type(item) for item in inner)
    if origin in (None, typing.Literal, Callable) or items == inner:
        return kind
    if origin in (typing.Union, types.UnionType):
        return functools.reduce(operator.or_, items)
    return origin[items]


def from_plain(kind: type[T], data: Any) -> T:
    """A configuration or plain data from the result of `asdict`, also after JSON or YAML.

    Args:
        kind: A class that `checked` made.
        data: Its fields by name.

    Raises:
        ValueError: If a field is missing, unknown, of another type or out of its range; the message
            names it.
    """
    as_any: Any = kind
    try:
        text = json.dumps(data)
    except (TypeError, ValueError, RecursionError) as error:
        found = _unplain(data) if isinstance(error, TypeError) else str(error)
        raise ValueError(f"{kind.__name__}: expected plain data, got {found}.") from None
    try:
        return _adapter(as_any).validate_json(text)
    except ValidationError as error:
        names = _field_names(kind)
        raise ValueError(_describe(kind.__name__, error, json.loads(text), names)) from None


def check_value(who: str, name: str, value: Any, kind: Any) -> Any:
    """An argument of a function, checked against one of this module's types.

    Args:
        who: The function or class, for the error message.
        name: The argument's name.
        value: What was given.
        kind: The type, `Count` for instance.

    Returns:
        The value; NumPy's numbers as Python's and lists as tuples, where the type says so.

    Raises:
        ValueError: If the value is of another type or out of its range.
    """
    try:
        return _adapter(kind).validate_python(value)
    except ValidationError as error:
        raise ValueError(_describe(who, error, value, (), name)) from None


def _unplain(data: Any, path: str = "") -> str | None:
    """First value that JSON cannot hold, with its place."""
    if isinstance(data, Mapping):
        inner = [(f"{path}.{key}" if path else str(key), value) for key, value in data.items()]
        if odd := [key for key in data if not isinstance(key, str | int | float | None)]:
            return f"the name {_shortened(odd[0])} in {path or 'it'}"
    elif isinstance(data, list | tuple):
        inner = [(f"{path}[{i}]", value) for i, value in enumerate(data)]
    elif isinstance(data, str | int | float | None):
        return None
    else:
        return f"{_shortened(data)} for {path or 'it'}"
    return next(filter(None, (_unplain(value, place) for place, value in inner)), None)


@functools.cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind, config=None if dataclasses.is_dataclass(kind) else _CONFIG)


def _field_names(kind: Any) -> list[str]:
    return [field.name for field in dataclasses.fields(kind) if field.init]


_MISUSES = {
    "missing": "{name!r} is missing",
    "missing_argument": "{name!r} is missing",
    "missing_keyword_only_argument": "{name!r} is missing",
    "unexpected_keyword_argument": "got an unexpected keyword argument {name!r}",
    "unexpected_positional_argument": "got an unexpected positional argument",
    "multiple_argument_values": "got {name!r} twice",
}
"""Errors in how a class is called, rather than in a value."""
_EXPECTED = {
    "bool_type": "True or False",
    "callable_type": "a function",
    "dict_type": "a mapping",
    "dataclass_exact_type": "of type {class_name}",
    "dataclass_type": "of type {class_name}",
    "finite_number": "finite",
    "float_type": "a number",
    "greater_than": "> {gt:g}",
    "greater_than_equal": ">= {ge:g}",
    "int_from_float": "a whole number",
    "int_parsing_size": "a whole number of usual size",
    "int_type": "a whole number",
    "is_instance_of": "of type {class}",
    "less_than": "< {lt:g}",
    "less_than_equal": "<= {le:g}",
    "list_type": "a list",
    "literal_error": "{expected}",
    "mapping_type": "a mapping",
    "path_type": "a path",
    "none_required": "None",
    "sequence_str": "a sequence",
    "string_pattern_mismatch": "text of the form {pattern}",
    "string_too_short": "text that is not empty",
    "string_type": "text",
    "too_long": "of length {max_length}",
    "too_short": "of length >= {min_length}",
    "tuple_type": "a tuple",
}
"""What was expected, by the types of pydantic's errors."""


def _describe(
    who: str, error: ValidationError, data: Any, names: Sequence[str], root: str = ""
) -> str:
    """Pydantic's errors in this library's words: fields, what was expected and what came.

    Args:
        who: The class or function, which the message begins with.
        error: Pydantic's error.
        data: What was checked.
        names: Names of the fields that the data may have.
        root: Name of the data itself, if it is no set of fields.
    """
    expected: dict[str, list[str]] = {}
    got: dict[str, str] = {}
    misuses: list[str] = []
    for problem in error.errors(include_url=False):
        kind, context = problem["type"], problem.get("ctx", {})
        path = _path(problem["loc"], data, root)
        if kind in ("value_error", "assertion_error"):  # a class's own __post_init__
            return str(context.get("error", problem["msg"]))
        if kind in _MISUSES and not path.endswith("]"):
            misuses.append(_MISUSES[kind].format(name=path))
            continue
        if kind in _MISUSES:  # a tuple that is too short
            expected.setdefault(path.rpartition("[")[0], []).append("longer")
            got[path.rpartition("[")[0]] = _shortened(problem["input"])
            continue
        expected.setdefault(path, []).append(_EXPECTED.get(kind, problem["msg"]).format(**context))
        got[path] = _shortened(problem["input"])
    if misuses:
        return f"{who}: {'; '.join(misuses)}; expected some of {sorted(names)}."
    # Where a field may be several things, the item that is none of them says most.
    inner = [a for a in expected if not any(b.startswith((f"{a}.", f"{a}[")) for b in expected)]
    texts = (
        f"{path or 'it'} must be {' or '.join(dict.fromkeys(expected[path]))}, got {got[path]}"
        for path in inner
    )
    return f"{who}: {'; '.join(texts)}."


def _path(location: Sequence[int | str], data: Any, root: str) -> str:
    """Where the error is, in the data's own terms: pydantic also names the branches of unions."""
    path = root
    for step in location:
        if isinstance(step, int) and isinstance(data, Sequence) and not isinstance(data, str):
            path += f"[{step}]"
            data = data[step] if step < len(data) else None
        elif isinstance(data, Mapping) and (step in data or step == location[-1]):
            path = f"{path}.{step}" if path else str(step)
            data = data.get(step)
    return path


def _shortened(value: Any, limit: int = 200) -> str:
    text = repr(value)
    return text if len(text) <= limit else f"{text[:limit]}..."
