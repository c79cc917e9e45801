"""One full update against sb3-contrib's TQC on the same weights, batch and noise.

sb3 steps the temperature first (but uses its old value), then the critics, then the actor against
the *new* critics, then the targets. Its critic loss is a mean over critics where TorchRL's is a
sum, and its squashed log-probability adds 1e-6 inside the logarithm, set to 0 here.
"""

import gymnasium as gym
import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import GymWrapper

from modpush.agents import TQCConfig, make_tqc

sb3_contrib = pytest.importorskip("sb3_contrib")

OBS, ACT, BATCH = 5, 3, 16
HIDDEN = (24, 16)


class Still(gym.Env):
    observation_space = gym.spaces.Box(-10, 10, (OBS,), np.float32)
    action_space = gym.spaces.Box(-1, 1, (ACT,), np.float32)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return np.zeros(OBS, np.float32), {}

    def step(self, action):
        return np.zeros(OBS, np.float32), 0.0, False, False, {}


CONFIG = TQCConfig(
    hidden_sizes=HIDDEN, gamma=0.97, tau=0.1, actor_lr=1e-3, critic_lr=1e-3, alpha_lr=1e-3
)


def make_sb3():
    model = sb3_contrib.TQC(
        "MlpPolicy",
        Still(),
        learning_rate=CONFIG.actor_lr,
        gamma=CONFIG.gamma,
        tau=CONFIG.tau,
        ent_coef=f"auto_{CONFIG.alpha_init}",
        policy_kwargs={"net_arch": list(HIDDEN), "n_critics": 2, "n_quantiles": 25},
        seed=0,
    )
    model.actor.action_dist.epsilon = 0.0
    # Targets away from the critics, so that a mix-up of the two would show.
    for target in model.critic_target.parameters():
        target.data.add_(0.05 * torch.randn_like(target))
    return model


def linears(module):
    return [layer for layer in module.modules() if isinstance(layer, torch.nn.Linear)]


def sb3_actor(model):
    """sb3's actor as `(weight, bias)` a layer, its two heads stacked like our one."""
    hidden = [(layer.weight, layer.bias) for layer in linears(model.actor.latent_pi)]
    mean, scale = model.actor.mu, model.actor.log_std
    head = (torch.cat([mean.weight, scale.weight]), torch.cat([mean.bias, scale.bias]))
    return [*hidden, head]


def sb3_critics(critic):
    """sb3's critics as `(weight, bias)` a layer, stacked."""
    nets = [linears(net) for net in critic.q_networks]
    return [
        (torch.stack([x.weight for x in layer]), torch.stack([x.bias for x in layer]))
        for layer in zip(*nets, strict=True)
    ]


def our_critics(params):
    names = sorted(params["module"].keys(), key=int)
    return [
        (params["module", n, "weight"], params["module", n, "bias"])
        for n in names
        if ("module", n, "weight") in params.keys(True, True)
    ]


def our_actor(agent):
    return [(layer.weight, layer.bias) for layer in linears(agent.actor)]


def copy_layers(source, destination):
    for pair, other in zip(source, destination, strict=True):
        for tensor, mine in zip(pair, other, strict=True):
            mine.data.copy_(tensor)


def assert_layers_close(ours, theirs, tolerance):
    for pair, other in zip(ours, theirs, strict=True):
        for mine, tensor in zip(pair, other, strict=True):
            torch.testing.assert_close(mine.detach(), tensor.detach(), **tolerance)


def make_batch():
    torch.manual_seed(2)
    done = torch.rand(BATCH, 1) < 0.3
    after = {"observation": torch.randn(BATCH, OBS), "reward": torch.randn(BATCH, 1)}
    return TensorDict(
        {
            "observation": torch.randn(BATCH, OBS),
            "action": torch.rand(BATCH, ACT) * 2 - 1,
            "next": {**after, "done": done, "terminated": done},
        },
        batch_size=[BATCH],
    )


def step_sb3(model, batch, updates):
    from stable_baselines3.common.logger import configure
    from stable_baselines3.common.type_aliases import ReplayBufferSamples

    after = batch["next"]
    sample = ReplayBufferSamples(
        batch["observation"],
        batch["action"],
        after["observation"],
        after["terminated"].float(),
        after["reward"],
    )
    model.replay_buffer.sample = lambda *args, **kwargs: sample
    model.set_logger(configure(None, []))
    model.train(updates, BATCH)


def test_one_full_update_equals_sb3(monkeypatch):
    torch.manual_seed(0)
    model = make_sb3()
    agent = make_tqc(CONFIG, GymWrapper(Still()))
    loss = agent.loss
    copy_layers(sb3_actor(model), our_actor(agent))
    copy_layers(sb3_critics(model.critic), our_critics(loss.qvalue_network_params))
    copy_layers(sb3_critics(model.critic_target), our_critics(loss.target_qvalue_network_params))
    assert loss.target_entropy == model.target_entropy
    batch = make_batch()
    optimizers = {
        group["name"]: torch.optim.Adam(group["params"], group["lr"])
        for group in agent.optimizer.param_groups
    }
    num_critics = CONFIG.num_critics

    with monkeypatch.context() as patch:
        play_noise(patch)
        for _ in range(UPDATES):
            # The actor's own draw comes first in sb3, so its graph is made before the critics
            # move; the loss is taken again below with the same noise and the new critics.
            state = NOISE.position
            _, parts = loss.actor_loss(batch)
            alpha_loss = loss.alpha_loss(parts["log_prob"]).mean()
            critic_loss, _ = loss.qvalue_v2_loss(batch)
            (critic_loss / num_critics).backward()
            optimizers["critic"].step()
            after = NOISE.position
            NOISE.position = state
            actor_loss, _ = loss.actor_loss(batch)
            NOISE.position = after
            actor_loss.backward()
            alpha_loss.backward()
            optimizers["actor"].step()
            optimizers["alpha"].step()
            for optimizer in optimizers.values():
                optimizer.zero_grad()
            agent.target_updater.step()

    with monkeypatch.context() as patch:
        play_noise(patch)
        step_sb3(model, batch, UPDATES)

    tolerance = {"rtol": 2e-5, "atol": 2e-6}
    assert_layers_close(our_actor(agent), sb3_actor(model), tolerance)
    assert_layers_close(
        our_critics(loss.qvalue_network_params), sb3_critics(model.critic), tolerance
    )
    assert_layers_close(
        our_critics(loss.target_qvalue_network_params),
        sb3_critics(model.critic_target),
        tolerance,
    )
    torch.testing.assert_close(loss.log_alpha.detach(), model.log_ent_coef.detach()[0], **tolerance)
    moved = (sb3_actor(model)[0][0] - sb3_actor(make_sb3())[0][0]).abs().max()
    assert moved > 0.5 * CONFIG.actor_lr  # the update did something


UPDATES = 3


class _Noise:
    """Standard normal draws, the same sequence for both learners."""

    def __init__(self):
        self.draws = torch.randn(4 * UPDATES, BATCH, ACT, generator=torch.manual_seed(9))
        self.position = 0

    def __call__(self, *args, **kwargs):
        self.position += 1
        return self.draws[self.position - 1]


NOISE = _Noise()


def play_noise(patch):
    """One draw for the actor, one for the target: sb3's by `Normal.rsample`, ours by `randn`."""
    from torch.distributions import Normal

    NOISE.position = 0
    patch.setattr(Normal, "rsample", lambda self, shape=(): self.loc + self.scale * NOISE())
    patch.setattr(torch, "randn", NOISE)
