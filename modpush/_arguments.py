"""Arguments of functions and constructors, checked against their annotations once, at the call."""

import dataclasses
import functools
import inspect
import operator
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, Union

import numpy as np
from pydantic import BeforeValidator, Strict
from pydantic_core import PydanticCustomError
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor

from modpush._types import Key
from modpush._validation import check_value, plain_signature

__all__ = ["checked_arguments"]

F = TypeVar("F", bound=Callable[..., Any])
_PLAIN = (bool, int, float, str, Path, Tensor, TensorDictBase, type(None))
_LIBRARIES = ("pandas", "tensordict", "torch", "torchrl")
_CONTAINERS = (tuple, list, Sequence, Mapping, dict)


def checked_arguments(function: F) -> F:
    """Check the arguments of a function or constructor against its annotations.

    Checked are numbers, text, choices of a `Literal`, truth values, paths, keys, tensors, configurations,
    functions, classes of torch, TorchRL and pandas, and tuples, sequences and mappings of them; what may
    be anything else, such as a part of a user's own, is left to the function. Ranges are checked where
    the annotation has one, such as `modpush._types.Positive`. It takes some microseconds an argument, so
    it is for what is called once, not at every step.

    Args:
        function: The function. A constructor's errors name its class.

    Returns:
        The same function. It raises a ValueError, or a TypeError for arguments that are missing or
        unknown, which names function and argument.
    """
    signature, kinds = inspect.signature(function), functools.cache(lambda: _kinds(function))
    who = function.__qualname__.removesuffix(".__init__")

    @functools.wraps(function)
    def checking(*args: Any, **kwargs: Any) -> Any:
        try:
            bound = signature.bind(*args, **kwargs)
        except TypeError as error:
            raise TypeError(f"{who}: {error}.") from None
        for name, kind in kinds().items():
            if name in bound.arguments:
                given = bound.arguments[name]
                plain = _plain(given)
                check_value(who, name, plain, kind)
                if isinstance(given, np.ndarray):  # whose truth value and comparisons are arrays
                    bound.arguments[name] = plain
        return function(*bound.args, **bound.kwargs)

    checking.__signature__ = plain_signature(function)  # type: ignore[attr-defined]
    return checking  # type: ignore[return-value]  # it takes what the function takes


def _kinds(function: Callable[..., Any]) -> dict[str, Any]:
    """Types of the parameters that are checked, by name."""
    variadic = (inspect.Parameter.VAR_KEYWORD, inspect.Parameter.VAR_POSITIONAL)
    hints = typing.get_type_hints(function, include_extras=True)
    found = {}
    for name, parameter in inspect.signature(function).parameters.items():
        kind = _checkable(hints.get(name))
        if kind is not None and parameter.kind not in variadic:
            found[name] = kind
    return found


def _checkable(kind: Any) -> Any:
    """The type against which an annotation's arguments are checked; None if they may be anything."""
    if kind is NestedKey:
        return Key
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if origin in (Annotated, Literal) or kind in _PLAIN:
        return kind
    if origin in (Union, types.UnionType) or origin in _CONTAINERS:
        items = [item if item is Ellipsis else _checkable(item) for item in inner]
        if origin in (Union, types.UnionType):
            return None if None in items else functools.reduce(operator.or_, items)
        items = [Any if item is None else item for item in items]
        if origin is tuple:  # a list does for a tuple
            return Annotated[tuple[tuple(items)], Strict(False)]  # type: ignore[misc]  # of types found
        return origin[tuple(items)]
    if origin is Callable:
        return Callable
    if isinstance(kind, type) and (dataclasses.is_dataclass(kind) or _is_foreign(kind)):
        return Annotated[Any, BeforeValidator(functools.partial(_instance, kind))]
    return None


def _is_foreign(kind: type) -> bool:
    """Whether a class is of a library whose functions take nothing else in its place."""
    return kind.__module__.partition(".")[0] in _LIBRARIES


def _instance(kind: type, value: Any) -> Any:
    """The value, if it is of the class; pydantic's own would also take a dataclass apart."""
    if isinstance(value, kind):
        return value
    raise PydanticCustomError("is_instance_of", "of type", {"class": kind.__name__})


def _plain(value: Any) -> Any:
    """NumPy's numbers as Python's, also those in sequences; ranges as lists."""
    if isinstance(value, range):
        return list(value)
    if isinstance(value, np.generic | np.ndarray):
        return value.item() if value.ndim == 0 else value.tolist()
    if type(value) in (list, tuple):
        return type(value)(_plain(item) for item in value)
    return value
