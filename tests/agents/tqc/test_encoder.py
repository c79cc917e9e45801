"""Encoders that are trained end to end, on pictures that hold the answer."""

import copy
from dataclasses import replace

import torch
from tensordict import TensorDict
from torch import nn
from torchrl.data import Bounded, Composite, Unbounded
from torchrl.envs import ExplorationType, set_exploration_type

from modpush.agents import TQCConfig, encode_images, make_tqc_from_specs
from modpush.encoders.networks import ConvEncoder

SIDE = 16
CONFIG = TQCConfig(
    hidden_sizes=(32, 32),
    num_quantiles=5,
    top_quantiles_to_drop_per_net=0,
    gamma=0.0,
    critic_lr=1e-3,
    encoder=f"{__name__}:SmallEncoder",
)


class SmallEncoder(nn.Module):
    """Two convolutions; no need to look at 64 x 64 pixels for this."""

    latent_dim = 6

    def __init__(self) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.Conv2d(1, 4, 3, stride=2, padding=1),
            nn.ReLU(),
            nn.Conv2d(4, 4, 3, stride=2, padding=1),
            nn.ReLU(),
            nn.Flatten(),
            nn.Linear(4 * (SIDE // 4) ** 2, self.latent_dim),
        )

    def forward(self, window):
        return self.layers(window)


def make_agent(config=CONFIG, **kwargs):
    torch.manual_seed(0)
    specs = Composite(observation=Unbounded((2,)), window=Unbounded((1, SIDE, SIDE)))
    return make_tqc_from_specs(config, specs, Bounded(-1, 1, (1,)), **kwargs)


def pictures(size, generator):
    """One bright half: the reward is 1 if it is the left one, else -1; nothing else tells."""
    left = torch.rand(size, generator=generator) < 0.5
    window = torch.zeros(size, 1, SIDE, SIDE, dtype=torch.uint8)
    window[left, :, :, : SIDE // 2] = 200
    window[~left, :, :, SIDE // 2 :] = 200
    return window, torch.where(left, 1.0, -1.0).unsqueeze(-1)


def make_batch(seed, size=64):
    generator = torch.Generator().manual_seed(seed)
    window, reward = pictures(size, generator)
    following, _ = pictures(size, generator)
    flags = torch.zeros(size, 1, dtype=torch.bool)
    after = {"observation": torch.randn(size, 2, generator=generator), "window": following}
    after |= {"reward": reward, "done": flags, "terminated": flags.clone()}
    now = {"observation": torch.randn(size, 2, generator=generator), "window": window}
    now |= {"action": torch.rand(size, 1, generator=generator) * 2 - 1}
    return TensorDict({**now, "next": after}, batch_size=[size])


def encoder_of(agent):
    return agent.actor.module[0].module.encoder


def train(agent, updates):
    torch.manual_seed(1)
    return [agent.update(make_batch(seed))["loss_qvalue"].item() for seed in range(updates)]


def test_the_critics_learn_what_only_the_picture_shows():
    agent = make_agent()
    before = [p.detach().clone() for p in encoder_of(agent).parameters()]
    losses = train(agent, 150)
    # Without the picture, the best guess is off by 1, at a Huber loss of 0.5 / 2 per critic.
    assert losses[0] > 0.3
    assert sum(losses[-10:]) / 10 < 0.05
    for old, new in zip(before, encoder_of(agent).parameters(), strict=True):
        assert not torch.equal(old, new)


def test_the_actor_s_loss_reaches_no_encoder_and_the_critics_does():
    agent = make_agent()
    encoder = list(encoder_of(agent).parameters())
    outputs = agent.loss(make_batch(0))
    outputs["loss_actor"].backward(retain_graph=True)
    assert all(p.grad is None for p in encoder)
    outputs["loss_qvalue"].backward()
    assert all(p.grad.abs().sum() > 0 for p in encoder)


def test_the_encoder_learns_at_the_critics_rate():
    agent = make_agent()
    groups = {group["name"]: group["params"] for group in agent.optimizer.param_groups}
    encoder = {id(p) for p in encoder_of(agent).parameters()}
    assert encoder <= {id(p) for p in groups["critic"]}
    assert not encoder & {id(p) for p in groups["actor"]}


def test_the_target_encoder_follows_slowly():
    agent = make_agent()
    weight = encoder_of(agent).layers[0].weight
    target = agent.loss.target_encoder_params["layers", "0", "weight"]
    before = weight.detach().clone()
    agent.update(make_batch(0))
    expected = before.lerp(weight.detach(), CONFIG.tau)
    torch.testing.assert_close(target, expected, rtol=0, atol=1e-8)
    assert not torch.equal(target, before)


def test_bytes_and_floats_have_the_same_latent():
    encoder = SmallEncoder()
    window = torch.randint(0, 256, (3, 2, 1, SIDE, SIDE), dtype=torch.uint8)
    latent = encode_images(encoder, window)
    assert latent.shape == (3, 2, 6)
    assert torch.equal(latent, encode_images(encoder, window.float() / 255))


def test_a_saved_agent_continues_as_before():
    first, second = make_agent(), make_agent()
    train(first, 5)
    second.loss.load_state_dict(first.loss.state_dict())
    second.optimizer.load_state_dict(copy.deepcopy(first.optimizer.state_dict()))
    third = make_agent()
    third.actor.load_state_dict(first.actor.state_dict())
    data = make_batch(9).select("observation", "window")
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        actions = [agent.actor(data.clone())["action"] for agent in (first, second, third)]
    assert torch.equal(actions[0], actions[1])
    assert torch.equal(actions[0], actions[2])
    assert train(first, 3) == train(second, 3)


def test_conv_encoder_trains():
    torch.manual_seed(0)
    specs = Composite(observation=Unbounded((2,)))
    config = TQCConfig(hidden_sizes=(8,), encoder="modpush.encoders:ConvEncoder")
    agent = make_tqc_from_specs(config, specs, Bounded(-1, 1, (1,)))
    assert type(encoder_of(agent)) is ConvEncoder
    batch = make_batch(0, size=4)
    window = torch.randint(0, 256, (4, 1, 64, 64), dtype=torch.uint8)
    batch["window"], batch["next", "window"] = window, window.flip(0)
    before = encoder_of(agent).layers[0].weight.detach().clone()
    agent.update(batch)
    assert not torch.equal(encoder_of(agent).layers[0].weight, before)


def test_an_encoder_object_stands_in_for_the_config_s():
    encoder = SmallEncoder()
    agent = make_agent(TQCConfig(hidden_sizes=(8,)), encoder=encoder)
    assert encoder_of(agent) is encoder


def test_the_encoder_trains_in_bfloat16_with_the_other_networks():
    found = {}
    for precision in ("float32", "bfloat16"):
        agent = make_agent(replace(CONFIG, precision=precision))
        seen = []
        encoder_of(agent).register_forward_hook(
            lambda _, __, latent, seen=seen: seen.append(latent)
        )
        torch.manual_seed(1)
        losses = agent.update(make_batch(0))
        found[precision] = losses, seen[0].dtype
        assert all(p.dtype == torch.float32 for p in agent.loss.parameters())
    assert [dtype for _, dtype in found.values()] == [torch.float32, torch.bfloat16]
    for key in ("loss_qvalue", "loss_actor"):
        one, other = (losses[key] for losses, _ in found.values())
        torch.testing.assert_close(one, other, rtol=0.03, atol=0.01)
