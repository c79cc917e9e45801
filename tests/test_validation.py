"""Wrong arguments of all public names are refused by name, before any work; right ones survive files.

The cases are generated: each parameter and each field gets wrong values that follow from its annotation.
"""

import dataclasses
import importlib
import inspect
import json
import math
import pickle
import pkgutil
import re
import types
import typing
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, Union

import numpy as np
import pytest
import tyro
from pydantic.dataclasses import is_pydantic_dataclass
from tensordict.utils import NestedKey
from torch import Tensor, nn

import modpush
from modpush._types import ONE_NUMBER, Count, Point
from modpush._validation import check_value, checked_arguments, from_plain
from modpush.agents.tqc.config import TQCConfig
from modpush.envs.scenes.obstacle import Obstacle
from modpush.envs.scenes.scenario import Scenario, ScenarioConfig
from modpush.files import dump_yaml, load_yaml
from modpush.planners import PlannerSubgoals
from modpush.recipes import PushEnvConfig, make_push_env
from modpush.replay import AttentiveSampler
from modpush.training import TrainConfig

OBSTACLE = Obstacle((0.1, 0.06, 0.06), (0.5, 0.1, 0.3))
SCENARIO = Scenario(
    scene="slot",
    difficulty=0.5,
    obstacles=(OBSTACLE,),
    pushed_object="small_cube",
    object_pose=(0.4, 0.1, 0.2),
    goal_position=(0.5, -0.2),
    tool_pose=(0.3, 0.1, 0.0),
)


def modules() -> Iterator[types.ModuleType]:
    """All modules of the library that load without a simulator or an extra."""
    for found in pkgutil.walk_packages(modpush.__path__, "modpush."):
        if ".engines" not in found.name and not found.name.endswith(("rendered", "__main__")):
            yield importlib.import_module(found.name)


def classes() -> list[type]:
    """All configurations and classes of plain data."""
    found = {
        value
        for module in modules()
        for _, value in inspect.getmembers(module, inspect.isclass)
        if value.__module__ == module.__name__ and is_pydantic_dataclass(value)
    }
    return sorted(found, key=lambda kind: kind.__qualname__)


def functions() -> dict[str, Callable[..., Any]]:
    """All functions and constructors whose arguments are checked, by name."""
    found: dict[str, Callable[..., Any]] = {}
    for module in modules():
        for name, value in inspect.getmembers(module):
            if getattr(value, "__module__", None) != module.__name__:
                continue
            members = vars(value).items() if inspect.isclass(value) else [(name, value)]
            for member, function in members:
                if not inspect.isfunction(function) or function.__code__ is not _CHECKED:
                    continue
                if function.__module__ == module.__name__:
                    owner = f"{name}." if inspect.isclass(value) else ""
                    found[(owner + member).removesuffix(".__init__")] = function
    return found


_CHECKED = checked_arguments(lambda: None).__code__
CLASSES = classes()
FUNCTIONS = functions()
ANYTHING = object()


def wrong_values(kind: Any) -> list[Any]:
    """Values that an argument or field of this type must refuse; empty where it may be anything."""
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if kind is NestedKey:
        return [3, (), "", ("a", 3), None]
    if origin in (Union, types.UnionType):
        several = [wrong_values(item) for item in inner]
        if not all(several):
            return []
        return [ANYTHING, 1j, b"3"] if len(inner) > 2 or type(None) not in inner else several[0][:1]
    if origin is Annotated:
        if any(isinstance(item, Callable) for item in kind.__metadata__):  # type: ignore[arg-type]
            return [ANYTHING]
        wrong = wrong_values(inner[0])
        if ONE_NUMBER in kind.__metadata__:  # it is a range, too
            wrong.remove(3)
        return wrong and [*wrong, *_beyond(inner[0], kind.__metadata__)]
    if kind in (int, float):
        return [True, "3", None, [1], ANYTHING, *([1.5, math.nan] if kind is int else [])]
    if kind is bool:
        return [0, 1, "yes", None]
    if kind is str:
        return [3, None, True, ("a",), ANYTHING]
    if kind in (Path, type(None)):
        return [3, True, ANYTHING]
    if origin is Literal:
        return ["", "no such choice", 3, ANYTHING]
    if origin is tuple:
        fixed = inner[-1] is not Ellipsis
        return ["abc", 3, None, *([(), (0.1,) * 9] if fixed else []), *_within(inner[0])]
    if origin in (Sequence, list):
        return [3, None, "abc", *_within(inner[0])]
    if origin in (Mapping, dict):
        return [3, None, [1]]
    if origin is Callable:
        return [3, "no function", None]
    if isinstance(kind, type) and origin is None:
        of_libraries = kind in (Tensor, nn.Module) or dataclasses.is_dataclass(kind)
        return [ANYTHING, 3, "no such", None] if of_libraries else []
    return []


def _within(kind: Any) -> list[Any]:
    return [(bad,) for bad in wrong_values(kind) if bad is not ANYTHING][:2]


def _beyond(base: Any, metadata: Sequence[Any]) -> list[Any]:
    """Numbers beyond the limits of a type, and what is too short."""
    found: list[Any] = []
    for item in metadata:
        for limit in getattr(item, "metadata", [item]):
            for name, step in (("gt", 0), ("ge", -1), ("lt", 0), ("le", 1)):
                if (bound := getattr(limit, name, None)) is not None and base in (int, float):
                    found.append(base(bound) + step)
            if getattr(limit, "allow_inf_nan", None) is False:
                found += [math.nan, math.inf]
            if getattr(limit, "min_length", None) and base is str:
                found.append("")
    return found


def hints(function: Any) -> dict[str, Any]:
    return typing.get_type_hints(inspect.unwrap(function), include_extras=True)


CASES = [
    (name, argument)
    for name, function in FUNCTIONS.items()
    for argument, parameter in inspect.signature(inspect.unwrap(function)).parameters.items()
    if parameter.kind not in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD)
    if wrong_values(hints(function).get(argument, Any))
]


def test_the_public_surface_is_checked() -> None:
    expected = """PushEnv make_push_env make_tqc make_replay_buffer Trainer evaluate load_agent
        save_agent AttentiveSampler NStepTransform OccupancyGrid PlannerSubgoals EgocentricWindow Encode
        PushObservation PushReward ActionFrame DepthVAE load_set"""
    assert set(expected.split()) <= set(FUNCTIONS)
    configs = """TrainConfig TQCConfig ReplayConfig PushEnvConfig RewardConfig CurriculumConfig Phase
        Camera ScenarioConfig Scenario Obstacle PushedObject Primitive Dynamics CorridorConfig
        EvaluationConfig EvaluationSet MotionConfig"""
    assert set(configs.split()) <= {kind.__name__ for kind in CLASSES}
    assert len(CASES) > 250


@pytest.mark.parametrize("name", sorted({name for name, _ in CASES}))
def test_a_wrong_argument_is_refused_by_name_before_any_work(name: str) -> None:
    function = FUNCTIONS[name]
    parameters = inspect.signature(function).parameters
    # All errors are collected before the body runs, so that the others need not be right.
    required = {
        key: ANYTHING for key, p in parameters.items() if p.default is p.empty and p.kind in (1, 3)
    }
    for argument in [argument for of, argument in CASES if of == name]:
        for wrong in wrong_values(hints(function)[argument]):
            with pytest.raises(ValueError, match=rf"^{re.escape(name)}: .*\b{argument}\b"):
                function(**{**required, argument: wrong})


@pytest.mark.parametrize("kind", CLASSES, ids=lambda kind: kind.__name__)
def test_a_wrong_field_is_refused_by_class_and_name(kind: type) -> None:
    fields = [field for field in dataclasses.fields(kind) if field.init]  # type: ignore[arg-type]
    empty = (dataclasses.MISSING, dataclasses.MISSING)
    required = {f.name: ANYTHING for f in fields if (f.default, f.default_factory) == empty}
    for field in fields:
        for wrong in wrong_values(hints(kind)[field.name]):
            with pytest.raises((ValueError, TypeError), match=rf"\b{field.name}\b"):
                kind(**{**required, field.name: wrong})


def test_every_config_is_checked() -> None:
    unchecked = {
        value.__name__
        for module in modules()
        for _, value in inspect.getmembers(module, inspect.isclass)
        if dataclasses.is_dataclass(value) and value.__name__.endswith("Config")
        if value.__module__.startswith("modpush")
    }
    assert unchecked <= {kind.__name__ for kind in CLASSES}


@pytest.mark.parametrize("kind", CLASSES, ids=lambda kind: kind.__name__)
def test_data_survive_json_yaml_pickle_and_replace(kind: type) -> None:
    known = {Obstacle: OBSTACLE, Scenario: SCENARIO}
    try:
        item: Any = known[kind] if kind in known else kind()
    except TypeError:
        pytest.skip("it has no defaults; tests of its own cover it")
    assert pickle.loads(pickle.dumps(item)) == item
    assert dataclasses.replace(item) == item
    plain = json.loads(json.dumps(dataclasses.asdict(item), default=str))
    assert from_plain(kind, plain) == item
    assert from_plain(kind, load_yaml(dump_yaml(plain))) == item


def test_values_survive_the_command_line(capsys: pytest.CaptureFixture[str]) -> None:
    args = ["--tau", "0.25", "--hidden-sizes", "8", "16", "--target-entropy", "-3.5"]
    expected = TQCConfig(tau=0.25, hidden_sizes=(8, 16), target_entropy=-3.5)
    assert tyro.cli(TQCConfig, args=args) == expected
    with pytest.raises(SystemExit):
        tyro.cli(TQCConfig, args=["--tau", "3"])
    assert "less than or equal to 1" in " ".join(capsys.readouterr().err.split())


def test_lists_and_numpy_numbers_become_python_s_own() -> None:
    config = TQCConfig(hidden_sizes=[8, np.int64(16)], tau=np.float32(0.5), batch_size=np.int32(4))
    assert config == TQCConfig(hidden_sizes=(8, 16), tau=0.5, batch_size=4)
    assert type(config.tau) is float
    assert type(config.batch_size) is int
    assert check_value("p", [1, np.float64(2)], Point) == (1.0, 2.0)
    assert check_value("n", np.int64(3), Count) == 3
    assert PlannerSubgoals("a_star", lags=np.array([1, 5])).lags == (1, 5)


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda: TQCConfig(colour="red"), TypeError, "TQCConfig: got an unexpected .* 'colour'"),
        (lambda: ScenarioConfig(distance=(0.0, 0.6)), ValueError, r"distance\[0\]: .*, got 0.0"),
        (
            lambda: from_plain(TrainConfig, {"env": {"reward": {"weights": {"goal": "high"}}}}),
            ValueError,
            "TrainConfig: env.reward.weights.goal: .* valid number, got 'high'",
        ),
        (lambda: from_plain(TrainConfig, {"tqc": {"tua": 1}}), ValueError, "tqc.tua: Unexpected"),
        (lambda: from_plain(TrainConfig, {"tqc": ANYTHING}), ValueError, "expected plain data"),
        (lambda: make_push_env(PushEnvConfig(), colour=1), TypeError, "unexpected .* 'colour'"),
    ],
)
def test_errors_name_the_class_the_field_and_the_value(
    make: Any, error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        make()


def test_signatures_show_types_without_their_conditions() -> None:
    signatures = [
        str(inspect.signature(f)) for f in (TrainConfig, PlannerSubgoals, AttentiveSampler.__init__)
    ]
    assert "max_minutes: float | None = None" in signatures[0]
    assert "lags: collections.abc.Sequence[int] = (1, 5)" in signatures[1]
    assert "k: float = 4" in signatures[2]
    for text in signatures:
        assert "Annotated" not in text
        assert "FieldInfo" not in text
