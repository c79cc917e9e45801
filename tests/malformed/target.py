"""`Target`: a part of the public surface with right arguments, of which cases make wrong ones."""

import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

__all__ = ["BELOW_1", "KEYS", "NOT_FINITE", "NOT_POSITIVE", "UNKNOWN", "Target"]

NOT_FINITE = (math.nan, math.inf, -math.inf)
NOT_POSITIVE = (0.0, -1.0, *NOT_FINITE)
BELOW_1 = (0, -1, -(10**9))
UNKNOWN = ("", "no such", "no_module:thing", "modpush.planners:NoSuch")
KEYS = ("", (), 3, ("a", 3), ["a"])
"""No keys of a tensordict."""


@dataclass(frozen=True, kw_only=True)
class Target:
    """Something that is called."""

    name: str
    """Name for tables."""
    call: Callable[..., Any]
    """What is called with keyword arguments."""
    given: Callable[[], dict[str, Any]]
    """Makes right arguments, anew for each case; only these are made wrong."""
    bad: Mapping[str, Sequence[Any]] = field(default_factory=dict)
    """Further wrong values by argument."""
    only: Sequence[str] = ()
    """Arguments for which `bad` alone is tried, since they may be much else."""
    fixed: bool = False
    """Whether what is called takes no other keywords to refuse."""
    files: Sequence[str] = ()
    """Arguments that are paths of files that are read."""
    also: Mapping[str, Sequence[str]] = field(default_factory=dict)
    """Other names by which errors may call an argument."""

    may_be_none: Sequence[str] = ()
    """Arguments for which None is right, where the signature of what is called does not say so."""
    defaults: bool = False
    """Whether the fields of a mapping that is given have defaults, so that one may be missing."""

    def optional(self, argument: str) -> bool:
        """Whether None may be given for an argument."""
        if argument in self.may_be_none:
            return True
        try:
            parameter = inspect.signature(self.call).parameters.get(argument)
        except (TypeError, ValueError):
            return False
        if parameter is None:
            return False
        return parameter.default is None or "None" in str(parameter.annotation)
