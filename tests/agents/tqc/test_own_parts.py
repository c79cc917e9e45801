"""Own networks and losses: by name, as "module:name" and as objects."""

import pytest
import torch
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.data import Bounded, Composite, Unbounded
from torchrl.modules import ValueOperator
from torchrl.objectives import DDPGLoss, SACLoss, TQCLoss as TorchRLTQCLoss

from modpush.agents import TQCConfig, TQCLoss, make_tqc_from_specs
from modpush.agents.tqc.factories import mlp_actor, mlp_critic
from tests.agents.tqc.tqc_builders import make_pendulum_batch

OBSERVATION = Composite(observation=Unbounded((3,)))
ACTION = Bounded(-2, 2, (1,))
SMALL = TQCConfig(hidden_sizes=(16, 12), batch_size=8)
HERE = __name__


def sac_loss(config, actor, critics, specs):
    loss = SACLoss(actor, critics, num_qvalue_nets=len(critics), action_spec=specs.action)
    loss.make_value_estimator(gamma=config.gamma)
    return loss


def torchrl_tqc_loss(config, actor, critics, specs):
    loss = TorchRLTQCLoss(actor, critics, num_qvalue_nets=len(critics), action_spec=specs.action)
    loss.make_value_estimator(gamma=config.gamma)
    return loss


def ddpg_loss(config, actor, critics, specs):
    loss = DDPGLoss(actor, critics[0], delay_value=False)
    loss.make_value_estimator(gamma=config.gamma)
    return loss


class TwoHeads(nn.Module):
    def __init__(self, width):
        super().__init__()
        self.body = nn.Linear(4, width)
        self.heads = nn.ModuleList([nn.Linear(width, 3), nn.Linear(width, 4)])

    def forward(self, observation, action):
        hidden = torch.cat([observation, action], -1)
        hidden = self.body(hidden).tanh()
        return torch.cat([head(hidden) for head in self.heads], -1)


def two_headed_critic(config, specs):
    return ValueOperator(TwoHeads(8), in_keys=[specs.observation_key, specs.action_key])


def wide_actor(config, specs):
    actor = mlp_actor(config, specs)
    actor.made_here = True
    return actor


def build(config=SMALL, **parts):
    torch.manual_seed(0)
    return make_tqc_from_specs(config, OBSERVATION, ACTION, **parts)


def train(agent, updates=5):
    before = {n: p.detach().clone() for n, p in agent.loss.named_parameters() if p.requires_grad}
    for seed in range(updates):
        result = agent.update(make_pendulum_batch(seed))
    assert all(value.isfinite().all() for value in result.values())
    after = dict(agent.loss.named_parameters())
    moved = {name for name, value in before.items() if not torch.equal(value, after[name])}
    return result, moved, set(before)


SCALAR_CRITICS = TQCConfig(hidden_sizes=(16,), num_quantiles=1, top_quantiles_to_drop_per_net=0)


@pytest.mark.parametrize("given", [sac_loss, f"{HERE}:sac_loss"])
def test_torchrl_s_sac_loss_with_scalar_critics_trains(given):
    agent = build(SCALAR_CRITICS, loss=given)
    assert type(agent.loss) is SACLoss
    result, moved, trainable = train(agent)
    assert moved == trainable
    assert result["td_error"].shape == (8,)
    assert {group["name"] for group in agent.optimizer.param_groups} == {"actor", "critic", "alpha"}


def test_the_config_s_text_reaches_a_loss():
    config = TQCConfig(hidden_sizes=(8,), loss=f"{HERE}:torchrl_tqc_loss")
    agent = build(config)
    assert type(agent.loss) is TorchRLTQCLoss
    _, moved, trainable = train(agent)
    assert moved == trainable


def test_a_loss_without_target_networks_or_temperature_trains():
    def actor(config, specs):
        network = nn.Sequential(nn.Linear(3, 8), nn.Tanh(), nn.Linear(8, 1), nn.Tanh())
        return TensorDictModule(network, in_keys=["observation"], out_keys=["action"])

    config = TQCConfig(
        hidden_sizes=(8,), num_quantiles=1, top_quantiles_to_drop_per_net=0, num_critics=1
    )
    agent = build(config, loss=ddpg_loss, actor=actor)
    assert agent.target_updater is None
    assert [group["name"] for group in agent.optimizer.param_groups] == ["actor", "critic"]
    _, moved, trainable = train(agent)
    assert moved == trainable


@pytest.mark.parametrize("given", [two_headed_critic, f"{HERE}:two_headed_critic"])
def test_own_critics_train(given):
    with pytest.warns(UserWarning, match="cannot be batched"):
        agent = build(critic=given)
    assert type(agent.loss) is TQCLoss
    _, moved, trainable = train(agent)
    assert moved == trainable


def test_own_actors_train():
    agent = build(actor=wide_actor)
    assert agent.actor.made_here
    _, moved, trainable = train(agent)
    assert moved == trainable


def test_factories_see_the_config_and_the_specs():
    seen = []

    def critic(config, specs):
        seen.append((config, specs.observation_dim, specs.action.shape, specs.latent_dim))
        return mlp_critic(config, specs)

    build(critic=critic)
    assert seen == [(SMALL, 3, (1,), 0)] * 2
