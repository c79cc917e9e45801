"""Every configuration and plain-data class, field by field, with right values."""

import dataclasses
import json
import math
from functools import partial
from typing import Any

from modpush._validation import from_plain
from modpush.agents import TQCConfig
from modpush.envs import Scenario, ScenarioConfig
from modpush.envs.scenes.objects import PushedObject
from modpush.mdp import CurriculumConfig, Phase, RewardConfig
from modpush.recipes import PushEnvConfig
from modpush.replay import ReplayConfig
from modpush.training import TrainConfig
from tests.malformed.target import Target
from tests.test_validation import CLASSES, SCENARIO, annotation, example, wrong_values

_CONTRADICTORY: dict[type, list[tuple[str, dict[str, Any]]]] = {
    ScenarioConfig: [
        ("distance", {"distance": (0.6, 0.2)}),
        ("low", {"low": (1.0, 1.0), "high": (0.0, 0.0)}),
        ("pushed_object", {"pushed_object": ("small_cube", "small_cube")}),
        ("scene", {"scene": ()}),
        ("mass", {"mass": (2.0, 1.0)}),
    ],
    PushEnvConfig: [
        ("latent_dim", {"latent_dim": 8, "encoder": "none"}),
        ("encoder", {"encoder": "conv"}),
        ("pushed_object", {"pushed_object": ("small_cube", "no such")}),
        ("scene", {"scene": ("no such",)}),
        ("planner", {"planner": "dijkstra"}),
    ],
    ReplayConfig: [
        ("k_annealing_samples", {"k_end": 2.0, "k_annealing_samples": 0}),
        ("batch_size", {"batch_size": 100, "capacity": 10}),
        ("sampler", {"sampler": "greedy"}),
        ("similarity", {"similarity": "manhattan"}),
    ],
    CurriculumConfig: [
        ("distances", {"distances": (0.3, 0.2)}),
        ("first_stage", {"phases": (Phase(first_stage=99),)}),
        ("step_thresholds", {"promotion": "steps"}),
        ("step_thresholds", {"step_thresholds": (2, 1)}),
        ("final_distance", {"final_distance": (0.6, 0.2)}),
    ],
    TrainConfig: [
        ("greedy_envs", {"greedy_envs": 9}),
        ("batch_size", {"replay": ReplayConfig(batch_size=7)}),
        ("learning_starts", {"tqc": TQCConfig(learning_starts=1)}),
    ],
    TQCConfig: [
        ("min_alpha", {"min_alpha": 2.0, "max_alpha": 1.0}),
        ("top_quantiles_to_drop_per_net", {"top_quantiles_to_drop_per_net": 25}),
    ],
    RewardConfig: [("weights", {"weights": {"goal": math.nan}})],
}


def targets() -> list[Target]:
    """All of them."""
    return [
        *(_fields(kind) for kind in CLASSES),
        *(_contradictory(kind, *one) for kind, cases in _CONTRADICTORY.items() for one in cases),
        *(_plain(kind) for kind in (TrainConfig, PushEnvConfig, ScenarioConfig, TQCConfig)),
        Target(
            name="Scenario.from_dict",
            call=lambda data: Scenario.from_dict(data),
            given=lambda: {"data": json.loads(json.dumps(SCENARIO.to_dict()))},
            bad={"data": [[1], "text", None, {}, {"scene": 3}]},
            only=["data"],
            also={"data": ["Scenario"]},
        ),
        Target(
            name="PushEnvConfig.preset",
            call=lambda **given: PushEnvConfig.preset(**given),
            given=lambda: {"name": "cpu", "num_envs": 4, "planner": "a_star"},
            bad={"name": ["", "gpu"], "num_envs": [0, -1], "planner": ["", "no such"]},
            also={"name": ["preset"]},
        ),
    ]


def _fields(kind: type) -> Target:
    """Wrong values of each field, as the field's own type says what is wrong."""
    right = example(kind)
    names = [field.name for field in dataclasses.fields(kind) if field.init]
    return Target(
        name=kind.__name__,
        call=partial(dataclasses.replace, right),
        given=lambda: {name: getattr(right, name) for name in names},
        bad={name: _Drawn(annotation(kind, name)) for name in names},
        only=names,
    )


class _Drawn:
    """As many wrong values of a field as anybody asks for, by number."""

    def __init__(self, kind: Any) -> None:
        self.kind = kind

    def __len__(self) -> int:
        return 1000

    def __getitem__(self, number: int) -> Any:
        from hypothesis import given, seed, settings

        found: list[Any] = []

        @seed(int(number))
        @settings(max_examples=3, database=None, deadline=None)
        @given(wrong_values(self.kind))
        def draw(value: Any) -> None:
            found.append(value)

        draw()
        return found[-1]


def _contradictory(kind: type, field: str, options: dict[str, Any]) -> Target:
    return Target(
        name=f"{kind.__name__}({', '.join(options)})",
        call=lambda **_: dataclasses.replace(example(kind), **options),
        given=lambda: {field: None},
        bad={field: ["contradictory"]},
        only=[field],
        fixed=True,
        also={field: ["tqc.learning_starts", "pushed objects"]},
    )


def _plain(kind: type) -> Target:
    """A file's content."""
    data = json.loads(json.dumps(dataclasses.asdict(example(kind)), default=str))

    def read(**data: Any) -> Any:
        return from_plain(kind, data)

    return Target(
        name=f"from_plain({kind.__name__})",
        call=read,
        given=lambda: dict(data),
        also=dict.fromkeys(data, ("plain data",)),
        defaults=True,
        **(
            {"bad": {"inflation": ["3", -1.0]}, "only": ["inflation"]}
            if "inflation" in data
            else {}
        ),
    )


assert PushedObject in CLASSES
