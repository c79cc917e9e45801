"""SAC and TD3 by name: TorchRL's losses over networks with the outputs that they need."""

import pytest
import torch
from torchrl.envs import GymEnv
from torchrl.objectives import SACLoss, TD3Loss

from modpush.agents import TQCConfig, make_tqc

SMALL = TQCConfig(hidden_sizes=(16, 12), batch_size=8, gamma=0.9)
LOSSES = {"sac": SACLoss, "td3": TD3Loss}


@pytest.fixture(scope="module")
def env():
    return GymEnv("Pendulum-v1")


def make_batch(env, agent, steps=20):
    with torch.no_grad():
        return env.rollout(steps, agent.exploration_policy, break_when_any_done=False)


@pytest.mark.parametrize("name", LOSSES)
def test_an_update_moves_actor_critics_and_targets(env, name):
    torch.manual_seed(0)
    agent = make_tqc(SMALL, env, loss=name)
    assert type(agent.loss) is LOSSES[name]
    before = {key: value.clone() for key, value in agent.loss.state_dict().items()}
    batch = make_batch(env, agent)
    assert agent.critics[0](batch.clone())["state_action_value"].shape == (20, 1)
    result = agent.update(batch)
    assert result["td_error"].shape == (20,)
    moved = [key for key, value in before.items() if "weight" in key]
    assert any("target_qvalue" in key for key in moved)
    for key in moved:
        assert not torch.equal(agent.loss.state_dict()[key], before[key]), key


def test_td3_moves_a_target_actor_and_knows_no_temperature(env):
    agent = make_tqc(SMALL, env, loss="td3")
    assert any("target_actor" in key for key in agent.loss.state_dict())
    assert [group["name"] for group in agent.optimizer.param_groups] == ["actor", "critic"]


def test_the_deterministic_actor_squashes_its_output_into_the_bounds(env):
    agent = make_tqc(SMALL, env, loss="td3")
    batch = make_batch(env, agent)
    acted = agent.actor(batch.select("observation"))
    # Pendulum's action is in [-2, 2].
    torch.testing.assert_close(acted["action"], 2 * acted["param"].tanh())
    assert torch.equal(acted["action"], agent.actor(batch.select("observation"))["action"])


@pytest.mark.parametrize("name", LOSSES)
def test_targets_are_discounted_by_the_configs_gamma(env, name):
    """With a critic that always says 0, and no entropy, the target is the reward."""
    config = TQCConfig(**{**vars(SMALL), "alpha_init": 1e-9, "fixed_alpha": name == "sac"})
    agent = make_tqc(config, env, loss=name)
    batch = make_batch(env, agent)
    with torch.no_grad():
        for key, value in agent.loss.state_dict().items():
            if "qvalue" in key and isinstance(value, torch.Tensor):
                value.zero_()
    squares = batch["next", "reward"].square().mean()  # summed over two critics
    torch.testing.assert_close(agent.loss(batch)["loss_qvalue"], 2 * squares, rtol=1e-4, atol=0)
    assert agent.loss.value_estimator.gamma.item() == pytest.approx(0.9)
