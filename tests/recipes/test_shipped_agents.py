"""The agents that come with the library."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from modpush import load_agent, make_push_env
from modpush.envs.scenes.sampling import sample_scenario
from modpush.envs.scenes.scenario import Scenario, ScenarioConfig
from modpush.envs.scenes.shape_layouts import SHAPE_SCENES
from modpush.evaluation import generate_set, load_set
from modpush.evaluation.episodes import run_episodes
from modpush.recipes.agent_file import Agent, shipped_agents
from modpush.recipes.methods import get_method
from modpush.training import TRAIN_PRESETS


def test_there_are_four() -> None:
    assert sorted(shipped_agents()) == ["any_object", "paper", "pose", "small_cube"]


@pytest.mark.parametrize("name", ["any_object", "paper", "pose", "small_cube"])
def test_an_agent_is_a_policy_by_its_name(name: str) -> None:
    method = get_method(name)
    assert method.name == name
    weights = method.make_policy().state_dict()
    expected = load_agent(name).policy.state_dict()
    assert all(torch.equal(weights[key], expected[key]) for key in expected)


def test_any_object_is_of_the_preset_of_that_name() -> None:
    config = load_agent("any_object").config
    assert config.simulation.sim_freq == 120  # which the preset leaves to SAPIEN, whose own it is
    assert config.with_fields(sim_freq=None) == TRAIN_PRESETS["refine_any_object"].env


def test_paper_is_of_the_preset_paper_cpu_and_solves_the_five_families() -> None:
    agent = load_agent("paper")
    assert agent.config == TRAIN_PRESETS["paper_cpu"].env
    env = agent.make_env(8)
    assert env.observation_spec["observation"].shape == (8, 49)
    scenarios = load_set("tuning/small_cube").first(24).scenarios
    episodes = list(run_episodes(env, agent.policy, enumerate(scenarios)))
    env.close()
    assert sum(episode.metrics.success for episode in episodes) >= 20


def count_solved(agent: Agent, scenarios: Sequence[Scenario], **changes: Any) -> tuple[int, int]:
    """Number of episodes that an agent solves, and of those in which nothing touches an obstacle."""
    env = agent.make_env(8, **changes)
    episodes = list(run_episodes(env, agent.policy, enumerate(scenarios)))
    env.close()
    solved = [episode for episode in episodes if episode.metrics.success]
    return len(solved), sum(not e.trajectory.contacts[:, 1:].any() for e in solved)


def test_pose_is_of_its_preset() -> None:
    assert load_agent("pose").config == TRAIN_PRESETS["pose_obstacles"].env


@pytest.mark.parametrize(
    ("changes", "least", "least_clean"),
    [
        ({}, 52, 52),
        pytest.param(
            {"contact_filter": False, "motion_ahead": 0.0, "planner_clearance": 0.0},
            48,
            40,
            marks=pytest.mark.slow,
        ),
    ],
)
def test_pose_solves_poses_past_every_kind_of_obstacle(
    changes: dict[str, Any], least: int, least_clean: int
) -> None:
    """Eight episodes of each kind that no set holds, at 1.5 cm and 10 degrees."""
    agent = load_agent("pose")
    scenarios = [
        scenario
        for name in SHAPE_SCENES
        for scenario in generate_set(f"pose/{name}/box", range(5000, 5008)).scenarios
    ]
    assert agent.config.simulation.yaw_tolerance == pytest.approx(math.radians(10))
    solved, clean = count_solved(agent, scenarios, **changes)
    assert solved >= least
    assert clean >= least_clean


def test_pose_pushes_all_its_objects_past_every_kind_of_obstacle() -> None:
    """An episode of each object and each kind of obstacle that no set holds."""
    agent = load_agent("pose")
    scenarios = generate_set("pose/objects", range(5040, 5103)).scenarios
    assert len({(s.pushed_object, s.scene) for s in scenarios}) == len(scenarios) == 63
    assert {s.pushed_object for s in scenarios} == {*agent.config.scenario.pushed_object}
    solved, clean = count_solved(agent, scenarios)
    assert solved >= 61
    assert clean >= 60


def test_any_object_pushes_shapes_it_never_saw() -> None:
    """Random shapes of other seeds than those of its training, in free space."""
    agent = load_agent("any_object")
    names = [f"random_{seed}" for seed in range(101, 109)]
    assert not set(names) & set(agent.config.scenario.pushed_object)
    env = make_push_env(agent.config, num_envs=8, pushed_object=tuple(names))
    base = ScenarioConfig(scene="free", distance=(0.2, 0.5))
    scenarios = [
        sample_scenario(np.random.default_rng([5, k]), replace(base, pushed_object=name))
        for k, name in enumerate(names)
    ]
    episodes = list(run_episodes(env, agent.policy, enumerate(scenarios)))
    env.close()
    assert sum(episode.metrics.success for episode in episodes) >= 7
