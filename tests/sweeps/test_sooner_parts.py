"""The parts that `examples/sweeps/sooner.yaml` compares the preset with."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from benchmarks.sooner_parts import MirroredTQCLoss
from modpush import make_push_env
from modpush.agents import make_tqc
from modpush.envs import Scenario
from modpush.evaluation.sets import load_set
from modpush.replay import make_replay_buffer
from modpush.sweeps import load_sweep

SWEEP = Path(__file__).parents[2] / "examples" / "sweeps" / "sooner.yaml"
TRIALS = {trial.variant.name: trial for trial in load_sweep(SWEEP).trials() if trial.seed == 0}
NUM_ENVS = 8


def mirrored(scenario: Scenario) -> Scenario:
    """The episode on the other side of the base frame's x axis."""

    def pose(place):
        return place[0], *(-value for value in place[1:])

    return replace(
        scenario,
        obstacles=tuple(replace(bar, pose=pose(bar.pose)) for bar in scenario.obstacles),
        object_pose=pose(scenario.object_pose),
        goal_position=pose(scenario.goal_position),
        tool_pose=pose(scenario.tool_pose),
    )


def env_and_agent(name):
    config = TRIALS[name].config
    env = make_push_env(replace(config.env, num_envs=NUM_ENVS), seed=0)
    torch.manual_seed(0)
    return config, env, make_tqc(replace(config.tqc, batch_size=16), env)


def test_the_mirrored_observation_is_that_of_the_mirrored_scene():
    scenarios = load_set("tuning/small_cube").scenarios[::25]
    assert len(scenarios) == NUM_ENVS
    assert sum(len(scenario.obstacles) > 0 for scenario in scenarios) >= 4
    _, env, agent = env_and_agent("mirrored")
    assert type(agent.loss) is MirroredTQCLoss
    observation = env.reset(scenarios=scenarios)["observation"].clone()
    expected = env.reset(scenarios=[*map(mirrored, scenarios)])["observation"]
    env.close()
    assert (observation - expected).abs().max() > 0.5
    torch.testing.assert_close(agent.loss.mirrored(observation), expected, rtol=0, atol=1e-4)


@pytest.mark.parametrize("name", ["half_demonstrations", "mirrored", "crossq"])
def test_the_variants_learn_from_the_environment_s_transitions(name):
    config, env, agent = env_and_agent(name)
    small = replace(config.replay, capacity=128, batch_size=16, storage="tensor")
    buffer = make_replay_buffer(small)
    buffer.extend(env.rollout(12, agent.actor).flatten())
    env.close()
    before = [parameter.detach().clone() for parameter in agent.loss.parameters()]
    losses = agent.update(buffer.sample())
    assert all(value.isfinite().all() for value in losses.values())
    after = list(agent.loss.parameters())
    assert any(not torch.equal(*pair) for pair in zip(before, after, strict=True))
