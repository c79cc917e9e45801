"""The policies that the command line knows by name."""

import itertools
from pathlib import Path

import pytest

from modpush.envs import EpisodeConditions
from modpush.evaluation.results import describe_policy
from modpush.mdp import StuckRecovery
from modpush.planners import OccupancyGrid
from modpush.recipes import (
    METHODS,
    get_method,
    load_agent,
)
from modpush.recipes.agent_file import shipped_agents


def test_every_method_is_known_by_its_name_and_settings() -> None:
    found = [get_method(name) for name in METHODS]
    described = [describe_policy(method.make_policy()) for method in found]
    assert all(a != b for a, b in itertools.combinations(described, 2))
    assert found[2].make_policy().config.rules == "faithful"
    with pytest.raises(ValueError, match=r"no 'nobody', expected agent, .*training run's folder"):
        get_method("nobody")


@pytest.mark.parametrize(
    ("name", "recovery", "label"),
    [
        ("any_object", None, "any_object"),
        ("any_object", True, "any_object"),
        ("any_object", False, "any_object_without_recovery"),
        ("scripted", None, "scripted"),
        ("scripted", False, "scripted"),
        ("scripted", True, "scripted+recovery"),
    ],
)
def test_who_recovers(name: str, recovery: bool | None, label: str) -> None:
    method = get_method(name, recovery=recovery)
    assert method.name == label
    env = method.make_env(1, ("small_cube",))
    recovers = label in ("any_object", "scripted+recovery")
    assert sum(isinstance(t, StuckRecovery) for t in env.transform) == recovers
    assert ("recovering" in method.make_policy().in_keys) == recovers
    env.rollout(2, method.make_policy())
    env.close()


@pytest.mark.parametrize("name", ["corridor", "scripted"])
def test_the_environment_is_as_a_set_says(name: str) -> None:
    conditions = EpisodeConditions(
        max_episode_steps=40, tool="rod", sim_freq=240, inflation="inscribed"
    )
    env = get_method(name).make_env(1, ("large_cube",), conditions)
    assert not conditions.differences(env.simulation)
    td = env.reset()
    if name == "corridor":
        assert td["touch_radius"].item() == pytest.approx(0.025)  # half of the shorter side
        assert td["object_inscribed_radius"].item() == pytest.approx(0.025)
    else:
        assert env.transform[1].inflation == "inscribed"
    env.close()


@pytest.mark.parametrize("name", shipped_agents())
def test_a_shipped_agent_plans_with_the_widest_inflation_everywhere(name: str) -> None:
    agent = load_agent(name)
    tight = EpisodeConditions(inflation="inscribed", goal=agent.config.simulation.goal)
    assert agent.config.inflation == "widest"
    for env in (
        agent.make_env(2, scene="diagonal_walls", pushed_object="small_cube", seed=0),
        get_method(name).make_env(2, ("small_cube",), tight, scene="diagonal_walls", seed=0),
    ):
        (grid,) = (t for t in env.transform if isinstance(t, OccupancyGrid))
        assert grid.inflation == "widest"
        assert env.reset()["path_found"].all()
        env.close()


def test_an_agent_s_file_and_a_run_s_folder_are_found(tmp_path: Path) -> None:
    run = tmp_path / "my_run"
    run.mkdir()
    file = run / "best_agent.safetensors"
    file.write_bytes(shipped_agents()["small_cube"].read_bytes())
    for text, name in ((str(run), "my_run"), (str(file), "my_run_best_agent")):
        method = get_method(text)
        assert method.name == name
        env = method.make_env(1, ("small_cube",))
        assert "path" in env.full_observation_spec.keys()
        env.close()
