"""Malformed inputs, drawn at random, and what becomes of them."""

import dataclasses
import functools
import re
import traceback
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from tests.malformed.target import Target
from tests.malformed.values import wrong_file, wrong_value

OUTCOMES = ("clear", "accepted", "obscure", "crash", "hang")
_SAYS_WHAT = re.compile(
    r"\b(got|must|expected|missing|unexpected|holds|carries|not found|no file|there is no|"
    r"is not|does not|cannot|could not|invalid|damaged|no obstacle|names nothing|unrecognized)\b",
    re.IGNORECASE,
)
_INSIDE = ("/numba/", "/sapien/", "/pydantic/", "/mani_skill/")
_RAISED = (ValueError, TypeError, KeyError, OSError, RuntimeError, SystemExit)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Case:
    """One malformed input."""

    target: Target
    argument: str
    label: str
    arguments: dict[str, Any]

    def __str__(self) -> str:
        return f"{self.target.name}({self.argument}: {self.label})"


@functools.cache
def targets() -> tuple[Target, ...]:
    """The whole public surface."""
    from tests.malformed import (
        agents,
        buffers,
        environments,
        evaluations,
        files,
        saved_agents,
        states,
        transforms,
        viewing,
    )

    parts = (environments, states, transforms, agents, buffers, files, evaluations, saved_agents)
    late = (viewing,)
    return (*light_targets(), *(target for part in parts + late for target in part.targets()))


@functools.cache
def light_targets() -> tuple[Target, ...]:
    """Functions and configurations, which need neither a scene nor a file."""
    from tests.malformed import configs, images, networks, numbers, planning, shapes

    parts = (shapes, planning, images, networks, numbers, configs)
    return tuple(target for part in parts for target in part.targets())


def make_case(seed: int, number: int, every: tuple[Target, ...] = ()) -> Case:
    """Case `number` of a seed: targets (default: all) take turns, all else is drawn."""
    every = every or targets()
    target = every[number % len(every)]
    rng = np.random.default_rng([seed, number])
    arguments = target.given()
    names = [name for name in arguments if name not in target.only or name in target.bad]
    name = names[rng.integers(len(names))]
    if not target.fixed and rng.random() < 0.03:
        return Case(
            target=target, argument="colour", label="unknown", arguments={**arguments, "colour": 1}
        )
    label, value = _draw(target, name, arguments[name], rng)
    return Case(target=target, argument=name, label=label, arguments={**arguments, name: value})


def _draw(target: Target, name: str, value: Any, rng: np.random.Generator) -> tuple[str, Any]:
    bad = target.bad.get(name, ())
    if name in target.files and rng.random() < 0.8:
        return wrong_file(Path(value), rng)
    if bad and (name in target.only or rng.random() < 0.5):
        chosen = bad[rng.integers(len(bad))]
        return f"{chosen!r}"[:60], chosen
    drawn = wrong_value(value, rng, target.optional(name))
    while target.defaults and "without" in drawn[0]:
        drawn = wrong_value(value, rng, target.optional(name))
    return drawn


def judge(case: Case) -> tuple[str, str]:
    """What becomes of a malformed input: an outcome, and the error's text."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            result = case.target.call(**case.arguments)
        except _RAISED as error:
            text = f"{type(error).__name__}: {error}"
            return ("clear" if is_clear(error, case) else "obscure"), text
        except Exception as error:
            return "obscure", f"{type(error).__name__}: {error}"
    return "accepted", f"{result!r}"[:200]


def is_clear(error: BaseException, case: Case) -> bool:
    """Whether an error names the argument, says what came or was expected, and comes from no depth."""
    text = str(error)
    names = {case.argument, *case.target.also.get(case.argument, ())}
    names |= set(re.findall(r"'(\w+)'", case.label))  # a key of a mapping
    value = case.arguments.get(case.argument)
    named = any(re.search(rf"(?<!\w){re.escape(name)}(?!\w)", text) for name in names)
    if isinstance(value, Path | str) and str(value):
        named = named or str(value) in text
    frames = traceback.extract_tb(error.__traceback__)
    deep = any(part in frames[-1].filename for part in _INSIDE)
    return named and _SAYS_WHAT.search(text) is not None and not deep
