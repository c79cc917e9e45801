"""The parts that `examples/sweeps/sooner.yaml` compares the preset with."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from modpush import make_push_env
from modpush.agents import make_tqc
from modpush.replay import make_replay_buffer
from modpush.sweeps import load_sweep

SWEEP = Path(__file__).parents[2] / "examples" / "sweeps" / "sooner.yaml"
TRIALS = {trial.variant.name: trial for trial in load_sweep(SWEEP).trials() if trial.seed == 0}
NUM_ENVS = 8


def env_and_agent(name):
    config = TRIALS[name].config
    env = make_push_env(replace(config.env, num_envs=NUM_ENVS), seed=0)
    torch.manual_seed(0)
    return config, env, make_tqc(replace(config.tqc, batch_size=16), env)


@pytest.mark.parametrize("name", ["half_demonstrations", "crossq"])
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
