"""`make_tqc`: agents from a config."""

import copy
import pickle
import warnings
from dataclasses import replace

import pytest
import torch
from tensordict import TensorDict
from torchrl.collectors import Collector
from torchrl.data import (
    Bounded,
    Composite,
    LazyTensorStorage,
    TensorDictReplayBuffer,
    Unbounded,
)
from torchrl.envs import GymEnv, TransformedEnv
from torchrl.envs.transforms import RewardSum
from torchrl.trainers.algorithms import SACTrainer

from modpush.agents import TQCConfig, make_tqc, make_tqc_from_specs
from tests.agents.tqc.tqc_builders import make_pendulum_batch

SMALL = TQCConfig(hidden_sizes=(16, 12), batch_size=8)


@pytest.fixture
def env():
    return GymEnv("Pendulum-v1")


def rollout(env, agent, steps=20):
    with torch.no_grad():
        return env.rollout(steps, agent.exploration_policy, break_when_any_done=False)


@pytest.mark.parametrize("layer_norm", [False, True])
def test_an_update_moves_everything_it_should(env, layer_norm):
    torch.manual_seed(0)
    config = TQCConfig(hidden_sizes=(16, 12), layer_norm=layer_norm)
    agent = make_tqc(config, env)
    assert agent.loss._ensemble is not None
    before = {name: tensor.clone() for name, tensor in agent.loss.state_dict().items()}
    batch = rollout(env, agent)
    result = agent.update(batch)
    assert result["td_error"].shape == (20,)
    assert all(v.isfinite().all() and not v.requires_grad for v in result.values())
    for name, tensor in agent.loss.state_dict().items():
        if "weight" in name or name == "log_alpha":
            assert not torch.equal(tensor, before[name]), name
    assert all(p.grad is None for p in agent.loss.parameters())


def test_the_actor_acts_within_bounds_and_trains_in_place(env):
    agent = make_tqc(SMALL, env)
    weight = agent.actor.module[0].module[0][0].weight
    before = weight.clone()
    data = rollout(env, agent, 50)
    assert data["action"].abs().max() <= 2
    agent.update(data)
    assert not torch.equal(weight, before)


def test_exploration_noise_has_the_configured_size():
    env = GymEnv("Pendulum-v1")
    agent = make_tqc(TQCConfig(hidden_sizes=(8,), exploration_sigma=0.1), env)
    noise = agent.exploration_policy[-1]
    data = TensorDict({"action": torch.zeros(20_000, 1)}, batch_size=[20_000])
    # Pendulum's action is +-2: its half range times sigma is 0.2.
    assert noise(data)["action"].std().item() == pytest.approx(0.2, rel=0.05)


def test_target_entropy_is_minus_the_actions_width(env):
    assert make_tqc(SMALL, env).loss.target_entropy == -1
    agent = make_tqc(TQCConfig(hidden_sizes=(8,), target_entropy=-0.25), env)
    assert agent.loss.target_entropy == -0.25


EVERY_SETTING = TQCConfig(
    hidden_sizes=(6, 5),
    num_critics=3,
    num_quantiles=7,
    top_quantiles_to_drop_per_net=4,
    gamma=0.9,
    tau=0.25,
    alpha_init=0.3,
    min_alpha=0.1,
    max_alpha=0.7,
    target_entropy=-0.5,
    skip_done_states=True,
)


@pytest.mark.parametrize("name", ["tqc", "sac", "td3"])
def test_every_setting_reaches_the_loss_and_its_targets(name):
    config = replace(EVERY_SETTING, loss=name)
    observed, action = Composite(observation=Unbounded(3)), Bounded(-2, 2, (1,))
    agent = make_tqc_from_specs(config, observed, action)
    loss = agent.loss
    assert loss.num_qvalue_nets == 3
    assert loss.value_estimator.gamma.item() == pytest.approx(0.9)
    atoms = 7 if name == "tqc" else 1
    assert [critic.module[-1].out_features for critic in agent.critics] == [atoms] * 3
    if name == "tqc":
        assert loss.top_quantiles_to_drop_per_net == 4
    if name != "td3":
        bounds = loss.log_alpha, loss.min_log_alpha, loss.max_log_alpha
        assert [bound.exp().item() for bound in bounds] == pytest.approx([0.3, 0.1, 0.7])
        assert loss.target_entropy == -0.5
        assert loss.skip_done_states
    target = loss.target_qvalue_network_params.flatten_keys()
    before = {key: value.clone() for key, value in target.items()}
    with torch.no_grad():
        for value in loss.qvalue_network_params.values(True, True):
            value.add_(1.0)
    agent.target_updater.step()
    for key, value in target.items():  # by a quarter of the way
        torch.testing.assert_close(value, before[key] + 0.25, msg=str(key))


def test_parameter_groups_carry_their_learning_rates(env):
    config = TQCConfig(hidden_sizes=(8,), actor_lr=0.1, critic_lr=0.2, alpha_lr=0.3)
    groups = make_tqc(config, env).optimizer.param_groups
    assert {g["name"]: g["lr"] for g in groups} == {"actor": 0.1, "critic": 0.2, "alpha": 0.3}
    fixed = make_tqc(TQCConfig(hidden_sizes=(8,), fixed_alpha=True), env)
    assert [g["name"] for g in fixed.optimizer.param_groups] == ["actor", "critic"]


def test_sac_trainer_runs_the_agent():
    env = TransformedEnv(
        GymEnv("Pendulum-v1"), RewardSum(in_keys=["reward"], out_keys=["reward_sum"])
    )
    agent = make_tqc(SMALL, env)
    before = agent.loss.log_alpha.item()
    # The trainer writes the loss's actor into the collector's policy, so it takes the bare actor.
    collector = Collector(
        env,
        agent.actor,
        frames_per_batch=10,
        total_frames=40,
        init_random_frames=10,
        auto_register_policy_transforms=False,
    )
    buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(100), batch_size=8)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the trainer calls itself experimental
        trainer = SACTrainer(
            collector=collector,
            total_frames=40,
            frame_skip=1,
            optim_steps_per_batch=2,
            loss_module=agent.loss,
            optimizer=agent.optimizer,
            replay_buffer=buffer,
            target_net_updater=agent.target_updater,
            progress_bar=False,
            enable_logging=False,
        )
        trainer.train()
    assert agent.loss.log_alpha.item() != before


@pytest.mark.parametrize(
    "twin_of", [copy.deepcopy, lambda agent: pickle.loads(pickle.dumps(agent))]
)
def test_a_copied_agent_trains_as_the_original(env, twin_of):
    torch.manual_seed(0)
    agent = make_tqc(SMALL, env)
    batch = make_pendulum_batch(8)
    twin = twin_of(agent)
    for one in (agent, twin):
        torch.manual_seed(1)
        for _ in range(3):
            one.update(batch.clone())
    for name, value in agent.loss.state_dict().items():
        torch.testing.assert_close(twin.loss.state_dict()[name], value)
    for mine, other in zip(agent.actor.parameters(), twin.actor.parameters(), strict=True):
        torch.testing.assert_close(other, mine)
        assert other is not mine


def test_one_optimizer_equals_three(env):
    """A fused Adam with three groups steps like three plain ones."""
    ends = []
    for split in (False, True):
        torch.manual_seed(0)
        agent = make_tqc(SMALL, env)
        optimizers = [agent.optimizer]
        if split:
            groups = agent.optimizer.param_groups
            optimizers = [torch.optim.Adam(g["params"], lr=g["lr"]) for g in groups]
        torch.manual_seed(1)
        for seed in range(5):
            losses = agent.loss(make_pendulum_batch(seed))
            for name in ("loss_actor", "loss_qvalue", "loss_alpha"):
                losses[name].backward()
            for optimizer in optimizers:
                optimizer.step()
                optimizer.zero_grad()
            agent.target_updater.step()
        ends.append(torch.cat([p.detach().flatten() for p in agent.loss.parameters()]))
    torch.testing.assert_close(*ends, rtol=1e-5, atol=1e-7)
