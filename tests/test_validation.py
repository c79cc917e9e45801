"""Every configuration and plain-data class: wrong values are refused, right ones survive files."""

import dataclasses
import importlib
import inspect
import json
import math
import pickle
import pkgutil
import types
import typing
from collections.abc import Iterator
from datetime import date
from pathlib import Path
from typing import Annotated, Any, Literal, Union

import numpy as np
import pytest
import tyro
from hypothesis import HealthCheck, assume, given, settings, strategies as st
from pydantic.dataclasses import is_pydantic_dataclass
from pydantic.fields import FieldInfo

import modpush
from modpush._types import ONE_NUMBER, Count, Point, Scenes
from modpush._validation import check_value, from_plain
from modpush._yaml import dump_yaml, load_yaml
from modpush.agents.tqc.config import TQCConfig
from modpush.envs.robot.ur5_2f85 import LINKS, TOOLS
from modpush.envs.scenes.objects import OBJECTS, PushedObject
from modpush.envs.scenes.obstacle import Obstacle
from modpush.envs.scenes.scenario import Scenario, ScenarioConfig
from modpush.evaluation.sets import EvaluationSet
from modpush.geometry.shapes import Primitive
from modpush.mdp.curriculum import CurriculumConfig, Phase
from modpush.planners import PlannerSubgoals
from modpush.recipes import agent_file
from modpush.recipes.config import PushEnvConfig
from modpush.replay import AttentiveSampler
from modpush.training import TRAIN_PRESETS, TrainConfig

NETWORK = agent_file._Network(hidden_sizes=(8,), observation_dim=4, actor="mlp")
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
WITHOUT_DEFAULTS: dict[type, Any] = {
    Obstacle: OBSTACLE,
    Scenario: SCENARIO,
    EvaluationSet: EvaluationSet(name="mine", scenarios=(SCENARIO,)),
    Primitive: Primitive(kind="box", size=(0.1, 0.2, 0.3)),
    PushedObject: OBJECTS["small_cube"],
    agent_file._Network: NETWORK,
    agent_file._Content: agent_file._Content(
        env=PushEnvConfig(), network=NETWORK, fingerprint={}, parts={}, make_env=None, metadata={}
    ),
    type(LINKS[0]): LINKS[0],
    type(TOOLS["rod"]): TOOLS["rod"],
}
BASE = "modpush."


def checked_classes() -> Iterator[type]:
    for found in pkgutil.walk_packages(modpush.__path__, BASE):
        if ".sim." in found.name or found.name.endswith((".sim", ".rendered", "__main__")):
            continue  # needs a simulator, and holds no configuration
        module = importlib.import_module(found.name)
        for _, value in inspect.getmembers(module, inspect.isclass):
            if value.__module__ == found.name and is_pydantic_dataclass(value):
                yield value


CLASSES = sorted(checked_classes(), key=lambda kind: kind.__name__)
FIELDS = [
    (kind, field.name) for kind in CLASSES for field in dataclasses.fields(kind) if field.init
]


def example(kind: type) -> Any:
    return WITHOUT_DEFAULTS[kind] if kind in WITHOUT_DEFAULTS else kind()


def annotation(kind: type, name: str) -> Any:
    return typing.get_type_hints(kind, include_extras=True)[name]


def bounds(metadata: Any) -> dict[str, float]:
    """The limits of a number, by pydantic's names."""
    found: dict[str, float] = {}
    for item in metadata:
        for one in item.metadata if isinstance(item, FieldInfo) else [item]:
            for name in ("gt", "ge", "lt", "le"):
                if getattr(one, name, None) is not None:
                    found[name] = getattr(one, name)
    return found


def allows_infinity(metadata: Any) -> bool:
    return not any(
        getattr(one, "allow_inf_nan", None) is False
        for item in metadata
        if isinstance(item, FieldInfo)
        for one in item.metadata
    )


NOTHING_TAKES = [object(), 1j, b"3", bytearray(2), Ellipsis]


def wrong_values(kind: Any) -> st.SearchStrategy[Any]:
    """Values that a field of this type must refuse."""
    origin = typing.get_origin(kind)
    never = st.sampled_from(NOTHING_TAKES)
    if origin in (Union, types.UnionType):
        return never
    base, metadata = kind, ()
    if origin is Annotated:
        base, metadata = typing.get_args(kind)[0], kind.__metadata__
    if base is bool:
        return never | st.sampled_from([0, 1, "yes", None, math.nan])
    if base in (int, float):
        return never | wrong_numbers(base, metadata)
    if base is Path:
        return never | st.sampled_from([3, None, True])
    if base is str:
        return never | st.sampled_from([3, None, True, ("a",), math.nan])
    if typing.get_origin(base) is tuple:
        items = [item for item in typing.get_args(base) if item is not Ellipsis]
        numbers = [] if ONE_NUMBER in metadata else [3, 0.5]  # a number is a range of one
        tuples = st.sampled_from([*numbers, "abc", None, True, {0.1, 0.2}, frozenset({"a", "b"})])
        if typing.get_args(base)[-1] is not Ellipsis:
            tuples |= st.sampled_from([(), [], (0.1,) * 7])
        return never | tuples | wrong_values(items[0]).map(lambda bad: (bad,) * len(items))
    if typing.get_origin(base) is Literal:
        return never | st.sampled_from([3, None, "", "no such choice"])
    return never | st.sampled_from([3, "abc", None])


def wrong_numbers(base: type, metadata: Any) -> st.SearchStrategy[Any]:
    values: st.SearchStrategy[Any] = st.sampled_from([True, "3", None, (1,), [1], {}])
    if base is int:
        values |= st.floats() | st.sampled_from([10**400, -(10**400)])
    elif not allows_infinity(metadata):
        values |= st.sampled_from([math.nan, math.inf, -math.inf, 10**400, np.float32(np.nan)])
    limits = bounds(metadata)
    low, high = limits.get("gt", limits.get("ge")), limits.get("lt", limits.get("le"))
    number: Any = st.integers if base is int else st.floats
    beyond: dict[str, Any] = {} if base is int else {"allow_nan": False}
    if low is not None:
        least = int(math.ceil(low)) if base is int else low
        values |= number(max_value=least, **beyond).filter(
            lambda x: x < low or (x == low and "gt" in limits)
        )
    if high is not None:
        most = int(math.floor(high)) if base is int else high
        values |= number(min_value=most, **beyond).filter(
            lambda x: x > high or (x == high and "lt" in limits)
        )
    return values


def right_numbers(kind: Any) -> st.SearchStrategy[Any] | None:
    """Values of a field that holds one number; None for another field."""
    if typing.get_origin(kind) is not Annotated or typing.get_args(kind)[0] not in (int, float):
        return None
    limits = bounds(kind.__metadata__)
    low, high = limits.get("gt", limits.get("ge", 0)), limits.get("lt", limits.get("le", 1000))
    if typing.get_args(kind)[0] is int:
        return st.integers(int(low) + 1, max(int(min(high, 10**6)) - 1, int(low) + 1))
    return st.floats(low, min(high, 1e6), exclude_min=True, exclude_max=True)


def test_all_configurations_and_plain_data_are_checked() -> None:
    names = {kind.__name__ for kind in CLASSES}
    expected = "TrainConfig TQCConfig ReplayConfig PushEnvConfig RewardConfig CurriculumConfig"
    expected += " Phase ScenarioConfig Scenario Obstacle PushedObject Primitive Dynamics Camera"
    expected += " CorridorConfig ScriptedPusherConfig EvaluationConfig EvaluationSet MotionConfig"
    assert set(expected.split()) <= names
    unchecked = {
        value.__name__
        for found in pkgutil.walk_packages(modpush.__path__, BASE)
        if ".sim" not in found.name and not found.name.endswith(("rendered", "__main__"))
        for _, value in inspect.getmembers(importlib.import_module(found.name), inspect.isclass)
        if dataclasses.is_dataclass(value) and value.__name__.endswith("Config")
    }
    assert unchecked <= names


@pytest.mark.parametrize(("kind", "name"), FIELDS)
@settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_a_wrong_value_is_refused_by_class_and_field(kind: type, name: str, data: Any) -> None:
    value = data.draw(wrong_values(annotation(kind, name)))
    with pytest.raises(ValueError, match=rf"{kind.__name__}.*: .*{name}"):
        dataclasses.replace(example(kind), **{name: value})


@pytest.mark.parametrize("kind", CLASSES)
def test_examples_survive_json_yaml_pickle_and_replace(kind: type) -> None:
    item = example(kind)
    assert pickle.loads(pickle.dumps(item)) == item
    assert dataclasses.replace(item) == item
    if kind is PushedObject:  # some of its fields are computed
        return
    plain = json.loads(json.dumps(dataclasses.asdict(item), default=str))
    assert from_plain(kind, plain) == item
    assert from_plain(kind, load_yaml(dump_yaml(plain))) == item


@pytest.mark.parametrize("name", TRAIN_PRESETS)
def test_presets_survive_json_and_yaml(name: str) -> None:
    config = TRAIN_PRESETS[name][1]
    plain = json.loads(json.dumps(dataclasses.asdict(config)))
    assert from_plain(TrainConfig, load_yaml(dump_yaml(plain))) == config


NUMBERS = [
    (kind, name)
    for kind, name in FIELDS
    if kind is not PushedObject and right_numbers(annotation(kind, name)) is not None
]


@pytest.mark.parametrize(("kind", "name"), NUMBERS)
@settings(max_examples=10, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_a_right_number_survives_json_and_yaml(kind: type, name: str, data: Any) -> None:
    strategy = right_numbers(annotation(kind, name))
    assert strategy is not None
    try:
        item = dataclasses.replace(example(kind), **{name: data.draw(strategy)})
    except ValueError:
        assume(False)  # it does not fit the other fields
    plain = json.loads(json.dumps(dataclasses.asdict(item), default=str))
    assert from_plain(kind, load_yaml(dump_yaml(plain))) == item


@settings(max_examples=20, deadline=None)
@given(st.floats(1e-6, 1.0), st.lists(st.integers(1, 4096), min_size=1, max_size=4))
def test_values_survive_the_command_line(tau: float, widths: list[int]) -> None:
    args = ["--tau", repr(tau), "--hidden-sizes", *map(str, widths), "--target-entropy", "-3.5"]
    expected = TQCConfig(tau=tau, hidden_sizes=tuple(widths), target_entropy=-3.5)
    assert tyro.cli(TQCConfig, args=args) == expected


def test_the_command_line_names_a_wrong_field(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        tyro.cli(TQCConfig, args=["--tau", "3"])
    assert "tau must be <= 1" in capsys.readouterr().err


def test_lists_and_numpy_numbers_become_python_s_own() -> None:
    config = TQCConfig(hidden_sizes=[8, np.int64(16)], tau=np.float32(0.5), batch_size=np.int32(4))
    assert config == TQCConfig(hidden_sizes=(8, 16), tau=0.5, batch_size=4)
    assert type(config.tau) is float
    assert type(config.batch_size) is int
    assert hash(config) == hash(TQCConfig(hidden_sizes=(8, 16), tau=0.5, batch_size=4))


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda: TQCConfig(colour="red"), TypeError, "unexpected keyword argument 'colour'"),
        (lambda: Scenario(scene="free"), TypeError, "'difficulty' is missing; 'obstacles'"),
        (lambda: Obstacle((0.1, 0.1, 0.1)), TypeError, "Obstacle: 'pose' is missing"),
        (
            lambda: Obstacle((0.1, 0.1), (0, 0, 0)),
            ValueError,
            r"Obstacle: size must be longer, got \(0.1, 0.1\)",
        ),
        (
            lambda: dataclasses.replace(SCENARIO, obstacles=(OBSTACLE,) * 25),
            ValueError,
            "obstacles must be of length 24",
        ),
        (
            lambda: ScenarioConfig(distance=(0.0, 0.6)),
            ValueError,
            r"distance\[0\] must be > 0, got 0.0",
        ),
        (
            lambda: CurriculumConfig(phases=[Phase(), "free"]),
            ValueError,
            r"phases\[1\] must be of type Phase",
        ),
        (
            lambda: from_plain(TrainConfig, {"env": {"reward": {"weights": {"goal": "high"}}}}),
            ValueError,
            r"TrainConfig: env.reward.weights.goal must be a number, got 'high'",
        ),
        (
            lambda: from_plain(TrainConfig, {"tqc": {"tua": 1}}),
            ValueError,
            "unexpected keyword argument 'tqc.tua'",
        ),
        (lambda: from_plain(TrainConfig, [1]), ValueError, "TrainConfig: it must be of type"),
        (
            lambda: from_plain(TrainConfig, {"tqc": {"a": [1, date(2026, 1, 1)]}}),
            ValueError,
            r"plain data, got datetime.date\(2026, 1, 1\) for tqc.a\[1\]",
        ),
        (lambda: from_plain(TrainConfig, {(1, 2): 3}), ValueError, r"got the name \(1, 2\) in it"),
        (lambda: check_value("f", "n", 0, Scenes), ValueError, "f: n must be >= 1, got 0"),
        (lambda: check_value("f", "p", [1, "a"], Point), ValueError, r"f: p\[1\] must be a number"),
    ],
)
def test_errors_say_who_what_came_and_what_was_expected(
    make: Any, error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        make()


def test_check_value_gives_back_plain_values() -> None:
    assert check_value("f", "p", [1, np.float64(2)], Point) == (1.0, 2.0)
    assert check_value("f", "n", np.int64(3), Count) == 3


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
