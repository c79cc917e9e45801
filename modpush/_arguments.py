"""Arguments of functions and constructors, checked by pydantic's `validate_call`."""

import functools
import inspect
import types
import typing
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, Union

from pydantic import InstanceOf, Strict, validate_call
from tensordict.utils import NestedKey

from modpush._types import Key
from modpush._validation import CONFIG, checking, plain_signature

F = TypeVar("F", bound=Callable[..., Any])
_PLAIN = (bool, int, float, str, Path, type(None))
_CONTAINERS = (list, Sequence, Mapping, dict)


def checked_arguments(function: F) -> F:
    """Check the arguments of a function or constructor against its annotations.

    Ranges are checked where the annotation has one, such as `modpush._types.Positive`. Classes are
    checked by `isinstance`, except for abstract ones and protocols, for which anything with the same
    methods may be given. It takes some microseconds per argument, so it is for functions that are called
    once, not at every step.

    Args:
        function: The function. A constructor's errors name its class.

    Returns:
        The same function. It raises a ValueError that names function and argument, or a TypeError for
        arguments that are missing or unknown.
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
