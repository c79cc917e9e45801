"""Demonstrations as transitions, in modpush's and in TorchRL's own way."""

import numpy as np
import pytest
import torch

from modpush.data import load_demonstrations
from modpush.replay import TRANSITION_KEYS, KeepTransition, ReplayConfig, make_replay_buffer


def test_transitions_are_those_that_training_stores(collected) -> None:
    found = load_demonstrations(collected)
    data = found.transitions
    kept = KeepTransition()(data)
    assert set(kept.keys(True, True)) == set(TRANSITION_KEYS)
    env = found.make_env(2)
    made = KeepTransition()(env.rollout(1, break_when_any_done=False)).reshape(-1)
    env.close()
    for key in TRANSITION_KEYS:
        assert kept[key].dtype == made[key].dtype
        assert kept[key].shape[1:] == made[key].shape[1:]
    ends = data["next", "done"][:, 0].nonzero()[:, 0]
    assert len(ends) == len(found.episodes) == 6
    torch.testing.assert_close(
        data["observation"][1 : ends[0] + 1], data["next", "observation"][: ends[0]], rtol=0, atol=0
    )
    assert data["episode"][ends].tolist() == [0, 1, 2, 3, 4, 5]


def test_a_replay_buffer_takes_them(collected) -> None:
    data = KeepTransition()(load_demonstrations(collected).transitions)
    config = ReplayConfig(capacity=2000, batch_size=16, sampler="uniform")
    buffer = make_replay_buffer(config)
    buffer.extend(data)
    assert len(buffer) == len(data)
    torch.testing.assert_close(
        buffer[: len(data)]["next", "observation"], data["next", "observation"], rtol=0, atol=0
    )
    assert buffer.sample()["action"].shape == (16, 3)


def test_episodes_are_chosen_by_policy_and_success(collected) -> None:
    found = load_demonstrations(collected, policies=["corridor"])
    assert {episode["policy"] for episode in found.episodes} == {"corridor"}
    assert len(found.episodes) == 3
    solved = load_demonstrations(collected, only_success=True)
    assert all(episode["success"] for episode in solved.episodes)
    with pytest.raises(
        ValueError, match=r"policies must be some of \['corridor', 'scripted'\], got \['duck'\]"
    ):
        load_demonstrations(collected, policies=["duck"])


def test_an_environment_that_observes_otherwise_is_refused(collected) -> None:
    found = load_demonstrations(collected)
    with pytest.raises(
        ValueError, match=r"not the environment that they were recorded in\. .*observation, entries"
    ):
        found.make_env(1, encoder="none")


def test_rewards_are_the_environment_s(collected) -> None:
    rewards = load_demonstrations(collected).transitions["next", "reward"]
    assert rewards.dtype == torch.float32
    assert np.isfinite(rewards.numpy()).all()
    assert rewards.std() > 0
