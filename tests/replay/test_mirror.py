"""Mirror images in a replay buffer."""

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer

from modpush.replay import (
    MirrorTransitions,
    ReplayConfig,
    extend_rollout,
    make_replay_buffer,
)


def transitions(count=64, done=None):
    observation = torch.arange(count + 1.0)[:, None].repeat(1, 4)
    flags = torch.zeros(count, 1, dtype=torch.bool)
    return TensorDict(
        {
            "observation": observation[:-1],
            "mirrored_observation": -observation[:-1],
            "action": torch.arange(1.0, count + 1)[:, None].repeat(1, 3),
            "next": {
                "observation": observation[1:],
                "mirrored_observation": -observation[1:],
                "reward": torch.ones(count, 1),
                "done": flags,
                "terminated": flags,
            },
        },
        [count],
    )


def test_a_transition_is_mirrored_whole_or_not_at_all():
    torch.manual_seed(0)
    given = transitions(1000)
    before = given.clone()
    batch = MirrorTransitions()(given)
    mirrored = batch["observation"][:, 0] < 0
    chosen = mirrored[1:]  # the first observation is its own mirror image
    assert 0.4 < chosen.float().mean() < 0.6
    for part, stored in ((batch, given), (batch["next"], given["next"])):
        expected = torch.where(
            mirrored[:, None], stored["mirrored_observation"], stored["observation"]
        )
        assert torch.equal(part["observation"][1:], expected[1:])
    signs = torch.where(chosen[:, None], torch.tensor([1.0, -1.0, -1.0]), torch.ones(3))
    assert torch.equal(batch["action"][1:], given["action"][1:] * signs)
    assert "mirrored_observation" not in {str(k) for k in batch.keys()} | set(batch["next"].keys())
    assert (given == before).all()


@pytest.mark.parametrize("n_steps", [1, 3])
@pytest.mark.parametrize("sampler", ["attentive", "uniform"])
def test_samples_of_a_replay_buffer_are_mirrored(n_steps, sampler):
    torch.manual_seed(0)
    config = ReplayConfig(
        capacity=400,
        batch_size=32,
        sampler=sampler,
        n_steps=n_steps,
    )
    buffer = make_replay_buffer(config)
    buffer.append_transform(MirrorTransitions())
    extend_rollout(buffer, transitions(300), num_envs=1)
    batch = buffer.sample()
    sign = batch["observation"].sign()
    assert {-1.0, 1.0} <= set(sign.flatten().tolist())
    # The mirrored next observation belongs to the mirrored observation, n steps on.
    assert torch.equal(
        (batch["next", "observation"] - batch["observation"]).abs(), torch.full((32, 4), n_steps)
    )
    stored = buffer.storage[:]
    assert (stored["mirrored_observation"] <= 0).all()
    assert (stored["observation"] >= 0).all()


def test_in_torchrls_own_buffer_a_seed_gives_the_same_batch():
    buffer = TensorDictReplayBuffer(
        storage=LazyTensorStorage(100), batch_size=16, transform=MirrorTransitions()
    )
    buffer.extend(transitions())
    batches = []
    for _ in range(2):
        torch.manual_seed(5)
        batches.append(buffer.sample())
    assert torch.equal(batches[0]["observation"], batches[1]["observation"])
