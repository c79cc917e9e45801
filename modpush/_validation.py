"""Fields and arguments that are checked by pydantic, with errors of one line.

`checked` makes a frozen dataclass whose fields are checked against their annotations, such as the
types of `modpush._types`, when one is made, replaced or read from a file. `from_plain` reads one from
what JSON and YAML hold. `checked_arguments` does the same for the arguments of a function. Conditions
between fields stay in a class's own `__post_init__`.
"""

import dataclasses
import functools
import inspect
import json
import operator
import re
import types
import typing
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, Union, dataclass_transform, overload

import numpy as np
from pydantic import ConfigDict, InstanceOf, Strict, TypeAdapter, ValidationError, validate_call
from pydantic.dataclasses import dataclass as pydantic_dataclass
from tensordict.utils import NestedKey

from modpush._types import Key

T = TypeVar("T")

CONFIG = ConfigDict(strict=True, extra="forbid", arbitrary_types_allowed=True)
"""Of all that pydantic checks here: True is not a number and "3" is not 3."""


@overload
def checked(cls: type[T]) -> type[T]: ...
@overload
def checked(*, kw_only: bool = True) -> Callable[[type[T]], type[T]]: ...
@dataclass_transform(
    frozen_default=True, kw_only_default=True, field_specifiers=(dataclasses.field,)
)
def checked(cls: type[T] | None = None, *, kw_only: bool = True) -> Any:
    """Make a frozen dataclass of a class, which checks its fields when one is made.

    An integer is accepted for a float, a list for a tuple, and NumPy's numbers for Python's.

    Returns:
        The class. Making one raises a ValueError that names class and field, the value and what was
        expected, and a TypeError for unknown and missing fields, as Python does.
    """
    if cls is None:
        return functools.partial(checked, kw_only=kw_only)
    made: Any = pydantic_dataclass(cls, frozen=True, kw_only=kw_only, config=CONFIG)
    made.__init__ = checking(made.__init__, inspect.signature(made), made.__name__, bound=True)
    made.__signature__ = plain_signature(made)
    made.__getstate__ = _fields_of
    return made


def _fields_of(instance: Any) -> dict[str, Any]:
    """The fields alone, without what was computed of them: another process looks parts up again."""
    return {field.name: getattr(instance, field.name) for field in dataclasses.fields(instance)}


def checking(
    validated: Callable[..., T], signature: inspect.Signature, name: str, *, bound: bool = False
) -> Callable[..., T]:
    """A function of pydantic's, with errors of one line that begin with a name.

    It takes NumPy's numbers for Python's, and raises a TypeError for missing and unknown arguments and a
    ValueError for wrong ones. `signature` is that of the arguments; `bound` says that the first one is an
    instance, which it does not list.
    """

    @functools.wraps(validated)
    def call(*args: Any, **kwargs: Any) -> T:
        try:
            return validated(*args, **kwargs)
        except ValidationError as error:
            first = error
        try:
            signature.bind(*args[bound:], **kwargs)
        except TypeError as error:
            names = [name for name in signature.parameters if name != "self"]
            raise TypeError(f"{name}: {error}; expected some of {names}.") from None
        plain = [_plain(value) for value in args], {k: _plain(v) for k, v in kwargs.items()}
        try:
            return validated(*plain[0], **plain[1])
        except ValidationError:
            raise ValueError(_one_line(name, first, list(signature.parameters))) from None

    return call


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
    """An object of a class of `checked` from the result of `asdict`, also after JSON or YAML.

    A ValueError names the field that is missing, unknown, of another type or out of its range.
    """
    try:
        text = json.dumps(data)
    except (TypeError, ValueError, RecursionError) as error:
        raise ValueError(f"{kind.__name__}: expected plain data: {error}.") from None
    try:
        found: T = _adapter(typing.cast(Any, kind)).validate_json(text)
        return found
    except ValidationError as error:
        fields = [field.name for field in dataclasses.fields(kind) if field.init]  # type: ignore[arg-type]  # made by `checked`
        raise ValueError(_one_line(kind.__name__, error, fields)) from None


def check_value(name: str, value: Any, kind: Any) -> Any:
    """A single value, checked against a type such as `modpush._types.Count`, or a ValueError.

    NumPy's numbers come back as Python's and lists as tuples, where the type says so.
    """
    adapter = _adapter(kind)
    try:
        return adapter.validate_python(value)
    except ValidationError:
        value = _plain(value)
    try:
        return adapter.validate_python(value)
    except ValidationError as error:
        raise ValueError(_one_line(name, error, [])) from None


@functools.cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind, config=None if dataclasses.is_dataclass(kind) else CONFIG)


def _plain(value: Any) -> Any:
    """NumPy's numbers and arrays as Python's numbers and lists, also in sequences; ranges as lists."""
    if isinstance(value, range | np.generic | np.ndarray):
        return list(value) if isinstance(value, range) else value.tolist()
    if type(value) in (list, tuple):
        return type(value)(_plain(item) for item in value)
    return value


_BRANCH = re.compile(r"[A-Z]|.*\W|(int|float|str|bool|none|callable|path|any)\Z")
"""Parts of a location that name a branch of a union."""


def _one_line(name: str, error: ValidationError, fields: list[str]) -> str:
    """Pydantic's errors in one line: the places, what was expected, and the values.

    `fields` are listed where one is unknown.
    """
    expected: dict[str, list[str]] = {}
    given: dict[str, str] = {}
    for problem in error.errors(include_url=False):
        if problem["type"] in ("value_error", "assertion_error"):  # a class's own __post_init__
            return str(problem.get("ctx", {}).get("error", problem["msg"]))
        steps = list(problem["loc"])
        if steps and isinstance(steps[0], int) and steps[0] < len(fields):  # given by position
            steps[0] = fields[steps[0]]
        place = "".join(
            f"[{step}]" if isinstance(step, int) else f".{step}"
            for number, step in enumerate(steps)
            if number == 0 or isinstance(step, int) or not _BRANCH.match(step)
        ).lstrip(".")
        text = problem["msg"]
        if problem["type"].startswith("unexpected") and len(steps) == 1:
            text += f", expected some of {fields}"
        expected.setdefault(place, []).append(text)
        given[place] = repr(problem["input"])
    texts = (
        (f"{place}: " if place else "")
        + " or ".join(dict.fromkeys(messages))
        + f", got {given[place][:200]}"
        for place, messages in expected.items()
    )
    return f"{name}: {'; '.join(texts)}."


F = TypeVar("F", bound=Callable[..., Any])
_PLAIN = (bool, int, float, str, Path, type(None))
_CONTAINERS = (list, Sequence, Mapping, dict)


def checked_arguments(function: F) -> F:
    """Check the arguments of a function or constructor against its annotations.

    Ranges are checked where the annotation has one, such as `modpush._types.Positive`. Classes are
    checked by `isinstance`, except for abstract ones and protocols, for which anything with the same
    methods may be given. It takes some microseconds per argument, so it is for functions that are called
    once, not at every step. The errors name class or function and argument: a ValueError, or a TypeError
    for arguments that are missing or unknown.
    """
    signature = inspect.signature(function)
    name = function.__qualname__.removesuffix(".__init__")

    @functools.cache  # at the first call, since classes of other modules may be annotated by name
    def check() -> Callable[..., Any]:
        def given(*args: Any, **kwargs: Any) -> Any:
            return args, kwargs

        hints = typing.get_type_hints(function, include_extras=True)
        kinds = {name: _checkable(kind) for name, kind in hints.items() if name != "return"}
        given.__annotations__ = kinds
        given.__signature__ = signature  # type: ignore[attr-defined]
        return checking(validate_call(config=CONFIG)(given), signature, name)

    @functools.wraps(function)
    def checking_call(*args: Any, **kwargs: Any) -> Any:
        args, kwargs = check()(*args, **kwargs)
        return function(*args, **kwargs)

    checking_call.__signature__ = plain_signature(function)  # type: ignore[attr-defined]
    return checking_call  # type: ignore[return-value]  # it takes what the function takes


def _checkable(kind: Any) -> Any:
    """An annotation as pydantic is to check it; Any where it cannot, or must not."""
    if kind is NestedKey:
        return Key
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if origin in (Annotated, Literal) or kind in _PLAIN:
        return kind
    items = tuple(item if item is Ellipsis else _checkable(item) for item in inner)
    if origin in (Union, types.UnionType):
        return Any if Any in items else Union[items]  # noqa: UP007  # of types that are found here
    if origin is tuple:  # a list is accepted for a tuple
        return Annotated[tuple[items], Strict(False)]  # type: ignore[valid-type]  # found here
    if origin is Collection:  # in any order, but no text
        return Union[Sequence[items], set[items], frozenset[items]]  # type: ignore[valid-type]  # noqa: UP007
    if origin in _CONTAINERS:
        return origin[items]
    if origin is Callable or kind is Callable:
        return Callable
    if isinstance(kind, type) and kind is not Any and origin is None and not _is_open(kind):
        return InstanceOf[kind]  # type: ignore[misc]  # a type that is found here
    return Any


def _is_open(kind: type) -> bool:
    """True for protocols and abstract classes."""
    return inspect.isabstract(kind) or getattr(kind, "_is_protocol", False)
