from dataclasses import replace

import pytest

from modpush.envs import ScenarioConfig
from modpush.recipes import make_push_env
from modpush.recipes.config import PushEnvConfig


def test_a_part_of_your_own_is_not_imported_by_a_config():
    """A config may come from a file, and a file must not decide what code is run."""
    names = {"encoder": "Encoder", "planner": "plan", "scene": "s", "depth": "Camera"}
    config = PushEnvConfig().with_fields(**{k: f"no_such_module:{n}" for k, n in names.items()})
    with pytest.raises(ValueError, match="cannot import 'no_such_module'"):
        make_push_env(config)


def test_single_fields_are_set_wherever_they_are() -> None:
    config = PushEnvConfig.preset("cpu", scene="slot", tool="rod", num_envs=3)
    assert (config.scenario.scene, config.simulation.tool, config.num_envs) == (("slot",), "rod", 3)
    assert config.with_fields() == config
    scenario = ScenarioConfig(scene="posts", difficulty=1)
    changed = config.with_fields(scenario=scenario, distance=(0.3, 0.4))
    assert changed.scenario == replace(scenario, distance=(0.3, 0.4))
    with pytest.raises(
        TypeError, match=r"unexpected keyword argument 'colour'; .*'difficulty'.*'oob'"
    ):
        PushEnvConfig().with_fields(colour="red")


def test_episodes_are_drawn_for_the_map_that_is_planned_on() -> None:
    for inflation, circle in (
        ("widest", "inscribed"),
        ("circumscribed",) * 2,
        (0.03, "circumscribed"),
    ):
        config = PushEnvConfig(inflation=inflation)
        assert config.filled_scenario().path_inflation == circle
    own = config.with_fields(path_inflation="inscribed")
    assert own.filled_scenario().path_inflation == "inscribed"
