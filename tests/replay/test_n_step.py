"""n-step returns: hand-computed sums, flags at their end, and the loss that reads them."""

import pytest
import torch
from tensordict import TensorDict
from torch import nn
from torchrl.data import Bounded, Composite, Unbounded
from torchrl.modules import ValueOperator

from modpush.agents import TQCConfig, make_tqc_from_specs
from modpush.replay import (
    ReplayConfig,
    extend_rollout,
    forget_open_steps,
    make_replay_buffer,
)

GAMMA = 0.5


def stretch(num_envs, num_steps, *, terminated=(), truncated=(), start=0):
    """`[num_steps * num_envs]`, environment after environment within a step.

    Environment e observes 100 e + t before its step t, whose reward is t + 1; the flags are lists
    of (environment, step).
    """
    rows = []
    for t in range(start, start + num_steps):
        observation = 100.0 * torch.arange(num_envs).unsqueeze(-1) + t
        flags = {}
        for name, where in (("terminated", terminated), ("truncated", truncated)):
            flags[name] = torch.tensor([[(e, t) in where] for e in range(num_envs)])
        after = {"observation": observation + 1, "reward": torch.full((num_envs, 1), t + 1.0)}
        after |= {**flags, "done": flags["terminated"] | flags["truncated"]}
        now = {"observation": observation, "action": torch.zeros(num_envs, 1)}
        rows.append(TensorDict({**now, "next": after}, batch_size=[num_envs]))
    return torch.cat(rows)


def make_buffer(storage="tensor", n_steps=3, **kwargs):
    settings = {"capacity": 100, "batch_size": 8, "sampler": "uniform", **kwargs}
    return make_replay_buffer(
        ReplayConfig(storage=storage, n_steps=n_steps, gamma=GAMMA, **settings)
    )


@pytest.mark.parametrize("storage", ["tensor", "memmap"])
@pytest.mark.parametrize("rollout_length", [1, 2, 5, 10])
def test_sums_and_next_observations(storage, rollout_length):
    buffer = make_buffer(storage)
    for start in range(0, 10, rollout_length):
        extend_rollout(buffer, stretch(2, rollout_length, start=start), num_envs=2)
    stored = buffer[:]
    assert len(stored) == 2 * (10 - 3)  # the last three steps wait
    # Environment after environment within a step.
    expected = torch.tensor([[100.0 * e + t] for t in range(7) for e in range(2)])
    assert torch.equal(stored["observation"], expected)
    assert torch.equal(stored["next", "observation"], expected + 3)
    # (t + 1) + 0.5 (t + 2) + 0.25 (t + 3) = 1.75 t + 2.75
    step = expected % 100
    torch.testing.assert_close(stored["next", "reward"], 1.75 * step + 2.75)
    assert (stored["steps_to_next_obs"] == 3).all()
    assert not stored["next", "done"].any()


@pytest.mark.parametrize("ending", ["terminated", "truncated"])
def test_a_sum_ends_with_the_episode_and_takes_its_flags(ending):
    buffer = make_buffer()
    extend_rollout(buffer, stretch(2, 10, **{ending: [(1, 4)]}), num_envs=2)
    stored = buffer[:].reshape(7, 2)
    first, second = stored[:, 0], stored[:, 1]
    assert not first["next", "done"].any()
    # The second's episode ends after its step 4: steps 2, 3 and 4 reach the end.
    flags = [False, False, True, True, True, False, False]
    assert second["next", ending].flatten().tolist() == flags
    assert second["next", "done"].flatten().tolist() == flags
    assert second["steps_to_next_obs"].tolist() == [3, 3, 3, 2, 1, 3, 3]
    assert second["next", "observation"].flatten().tolist() == [
        103, 104, 105, 105, 105, 108, 109,
    ]  # fmt: skip
    # Step 3: 4 + 0.5 * 5; step 4: 5; step 5 belongs to the next episode: 6 + 0.5 * 7 + 0.25 * 8.
    rewards = second["next", "reward"].flatten()
    assert rewards[3:6].tolist() == [6.5, 5.0, 11.5]


def test_no_sum_spans_a_reset_that_the_data_do_not_show():
    buffer = make_buffer()
    extend_rollout(buffer, stretch(1, 5), num_envs=1)
    forget_open_steps(buffer)
    extend_rollout(buffer, stretch(1, 5, start=50), num_envs=1)
    stored = buffer[:]
    assert stored["observation"].flatten().tolist() == [0, 1, 50, 51]
    assert (stored["next", "observation"] - stored["observation"] == 3).all()


def linear_constant(config, specs):
    """The same as a network that can be batched: weights of zero and a bias."""
    network = nn.Linear(2, 2)
    network.weight.data.zero_()
    network.bias.data.fill_(8.0)

    class Concatenated(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.network = network

        def forward(self, observation, action):
            return self.network(torch.cat([observation, action], -1))

    return ValueOperator(Concatenated(), in_keys=["observation", "action"])


def mlp_constant(config, specs):
    from modpush.agents.tqc.factories import mlp_critic

    critic = mlp_critic(config, specs)
    for parameter in critic.parameters():
        parameter.data.zero_()
    list(critic.parameters())[-1].data.fill_(8.0)
    return critic


@pytest.mark.filterwarnings("ignore:TQCLoss. these critics cannot be batched")
@pytest.mark.parametrize("critic", [mlp_constant, linear_constant])
def test_targets_discount_by_the_number_of_steps(critic):
    config = TQCConfig(
        hidden_sizes=(4,),
        gamma=GAMMA,
        num_quantiles=2,
        top_quantiles_to_drop_per_net=0,
        alpha_init=1e-30,  # no entropy in the targets
    )
    specs = Composite(observation=Unbounded((1,)))
    agent = make_tqc_from_specs(config, specs, Bounded(-1, 1, (1,)), critic=critic)
    buffer = make_buffer()
    data = stretch(1, 8, terminated=[(0, 3)])
    data["observation"], data["next", "observation"] = (
        data["observation"] / 100,
        data["next", "observation"] / 100,
    )
    extend_rollout(buffer, data, num_envs=1)
    targets = agent.loss.compute_target(buffer[:])[:, 0]
    # Step 0: 1 + 0.5 * 2 + 0.25 * 3 + 0.125 * 8 = 3.75; steps 1 to 3 reach the terminal state:
    # 2 + 1.5 + 1 = 4.5, 3 + 2 = 5, 4; step 4 bootstraps again: 5 + 3 + 1.75 + 1 = 10.75.
    torch.testing.assert_close(targets, torch.tensor([3.75, 4.5, 5.0, 4.0, 10.75]))
    assert agent.update(buffer.sample())["loss_qvalue"].isfinite()


@pytest.mark.parametrize("way", ["state_dict", "dumps"])
@pytest.mark.parametrize("begun", [0, 5])  # transitions that wait in the other buffer
def test_what_waits_is_part_of_the_state(tmp_path, way, begun):
    buffer, other = make_buffer(), make_buffer()
    extend_rollout(buffer, stretch(2, 5), num_envs=2)
    if begun:
        extend_rollout(other, stretch(2, begun, start=70), num_envs=2)
    if way == "dumps":
        buffer.dumps(tmp_path)
        other.loads(tmp_path)
    else:
        other.load_state_dict(buffer.state_dict())
    for each in (buffer, other):
        extend_rollout(each, stretch(2, 3, start=5), num_envs=2)
    assert (buffer[:] == other[:]).all()
    assert buffer[:]["observation"].max() == 104  # seven steps but for the last three


def test_no_batch_prepared_ahead_outlives_empty():
    buffer = make_buffer(n_steps=1, prefetch=2)
    buffer.extend(stretch(1, 20))
    buffer.sample()
    buffer.empty()
    buffer.extend(stretch(1, 20, start=50))
    assert min(float(buffer.sample()["observation"].min()) for _ in range(3)) >= 50
