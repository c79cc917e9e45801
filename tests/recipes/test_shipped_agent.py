"""The agent that is shipped solves what it should, from the observation that it was trained on."""

import json
from pathlib import Path

import torch

from modpush import load_agent
from modpush.envs import Scenario
from modpush.evaluation.episodes import run_episodes
from modpush.evaluation.sets import load_set

GOLDEN = Path(__file__).with_name("golden_observation.json")
LATENT = slice(0, 32)


def test_the_shipped_agent_solves_at_least_nine_of_ten_episodes() -> None:
    """Six in free space, and two in each family of obstacles."""
    agent = load_agent("small_cube")
    free, obstacles = load_set("free/small_cube"), load_set("obstacles/small_cube")
    scenarios = [*free.scenarios[:6], *obstacles.scenarios[:10]]
    env = agent.make_env(num_envs=8)
    solved = [
        episode.metrics.success for episode in run_episodes(env, agent.policy, enumerate(scenarios))
    ]
    env.close()
    assert len(solved) == 16
    assert sum(solved) >= 0.9 * 16


def test_the_shipped_agent_observes_what_it_was_trained_on() -> None:
    """A change of an entry, its scale or its place would make the agent worse without a word.

    The values are those of the release, of two scenes that stand beside them in the file. Only a
    change that comes with a new agent may change them.
    """
    golden = json.loads(GOLDEN.read_text())
    expected = torch.tensor(golden["observation"])
    env = load_agent("small_cube").make_env(num_envs=2)
    scenarios = [Scenario.from_dict(scenario) for scenario in golden["scenarios"]]
    observation = env.reset(scenarios=scenarios)["observation"]
    env.close()
    assert expected[:, LATENT].abs().amax(-1).min() > 0.1  # both see obstacles
    torch.testing.assert_close(observation, expected, atol=1e-6, rtol=1e-6)
