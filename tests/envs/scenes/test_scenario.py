import json

import numpy as np
import pytest

from modpush.envs.scenes.layouts import SCENES
from modpush.envs.scenes.objects import OBJECTS
from modpush.envs.scenes.sampling import sample_scenario
from modpush.envs.scenes.scenario import Scenario, ScenarioConfig


def test_one_seed_one_scenario_and_it_survives_json() -> None:
    config = ScenarioConfig(scene=tuple(SCENES), pushed_object=tuple(OBJECTS))
    first, second = (sample_scenario(np.random.default_rng(7), config) for _ in range(2))
    assert first == second
    assert Scenario.from_dict(json.loads(json.dumps(first.to_dict()))) == first


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"difficulty": 1.5}, "difficulty"),
        ({"difficulty": (1, 0)}, r"difficulty: Input should be a range"),
        ({"difficulty": True}, "difficulty"),
        ({"distance": 0.05}, "distance must reach beyond 0.05 m"),
        ({"distance": (0.6, 0.2)}, r"distance: Input should be a range"),
        ({"distance": 3.0}, "distance"),
        ({"scene": ()}, "scene"),
        ({"scene": "nowhere"}, r"scene: there is no 'nowhere', expected one of \['bar_across'"),
        ({"scene": 3}, "scene: 3 is not a function"),
        ({"pushed_object": ("small_cube", "egg")}, "there is no 'egg'"),
        ({"low": (1.0, 0.0)}, "low must be < high"),
    ],
)
def test_a_bad_config_fails_at_once(fields, message) -> None:
    with pytest.raises(ValueError, match=message):
        ScenarioConfig(**fields)


def test_a_single_value_stands_for_a_range_or_a_tuple() -> None:
    config = ScenarioConfig(scene="slot", difficulty=0.5, distance=1)
    assert config == ScenarioConfig(scene=("slot",), difficulty=(0.5, 0.5), distance=(1, 1))
