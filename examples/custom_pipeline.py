"""Our loss and sampler in a TorchRL pipeline of your own, on any Gymnasium task.

    python examples/custom_pipeline.py                        # Pendulum-v1, about two minutes
    python examples/custom_pipeline.py --loss torchrl --sampler uniform   # TorchRL's own parts

Networks, collector, storage and optimizer are TorchRL's. Two lines are ours, `TQCLoss` and
`AttentiveSampler`, and both have TorchRL's own beside them. Pendulum climbs from -1300 to -150.
"""

import logging
import time
from dataclasses import dataclass
from typing import Literal

import torch
import tyro
from tensordict.nn import NormalParamExtractor, TensorDictModule
from torch import nn
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, RandomSampler, TensorDictReplayBuffer
from torchrl.data.replay_buffers.scheduler import LinearScheduler
from torchrl.envs import ExplorationType, GymEnv, TransformedEnv, set_exploration_type
from torchrl.envs.transforms import DoubleToFloat
from torchrl.modules import MLP, ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.objectives import SoftUpdate, TQCLoss as TorchRLTQCLoss

from modpush.agents import TQCLoss
from modpush.replay import AttentiveSampler


@dataclass(frozen=True, kw_only=True)
class Config:
    """Settings of the training."""

    env_name: str = "Pendulum-v1"
    """Name of a Gymnasium task with a flat observation and a bounded action."""
    loss: Literal["modpush", "torchrl"] = "modpush"
    """Library whose TQC loss is used."""
    sampler: Literal["attentive", "uniform"] = "attentive"
    """Sampler of the replay buffer: our attentive one, or TorchRL's uniform one."""
    k: float = 4.0
    """Number of candidates per sampled transition of the attentive sampler, annealed to 1 halfway."""
    total_frames: int = 8000
    """Number of environment steps."""
    random_frames: int = 1000
    """Number of steps with random actions before learning starts."""
    frames_per_batch: int = 50
    """Number of steps that are collected at a time; as many updates follow."""
    batch_size: int = 128
    """Number of transitions in an update."""
    hidden_size: int = 128
    """Width of the two hidden layers."""
    learning_rate: float = 1e-3
    """Learning rate of Adam."""
    gamma: float = 0.98
    """Discount factor per step."""
    seed: int = 0
    """Seed of environment, networks and sampler."""


def make_env(config: Config) -> TransformedEnv:
    return TransformedEnv(GymEnv(config.env_name), DoubleToFloat())


def make_networks(
    config: Config, env: TransformedEnv
) -> tuple[ProbabilisticActor, list[ValueOperator]]:
    num_observations = env.observation_spec["observation"].shape[-1]
    num_actions = env.action_spec.shape[-1]
    shape = {"num_cells": [config.hidden_size] * 2, "activation_class": nn.ReLU}
    network = MLP(in_features=num_observations, out_features=2 * num_actions, **shape)
    actor = ProbabilisticActor(
        TensorDictModule(
            nn.Sequential(network, NormalParamExtractor()),
            in_keys=["observation"],
            out_keys=["loc", "scale"],
        ),
        in_keys=["loc", "scale"],
        spec=env.action_spec,
        distribution_class=TanhNormal,
        distribution_kwargs={"low": env.action_spec.space.low, "high": env.action_spec.space.high},
    )
    critics = [
        ValueOperator(
            MLP(in_features=num_observations + num_actions, out_features=25, **shape),
            in_keys=["observation", "action"],
        )
        for _ in range(2)
    ]
    return actor, critics


def evaluate(env: TransformedEnv, actor: ProbabilisticActor, episodes: int = 5) -> float:
    """Mean return of greedy episodes."""
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        returns = [env.rollout(1000, actor)["next", "reward"].sum() for _ in range(episodes)]
    return torch.stack(returns).mean().item()


def main(config: Config) -> float:
    """Train, and return the last evaluation return."""
    torch.manual_seed(config.seed)
    env = make_env(config)
    env.set_seed(config.seed)
    actor, critics = make_networks(config, env)

    loss_class = TQCLoss if config.loss == "modpush" else TorchRLTQCLoss
    loss = loss_class(actor, critics, num_qvalue_nets=len(critics))
    sampler, annealing = RandomSampler(), None
    if config.sampler == "attentive":
        sampler = AttentiveSampler(config.k)
        annealing = LinearScheduler(sampler, "k", 1.0, config.total_frames // 2)

    loss.make_value_estimator(gamma=config.gamma)
    target_updater = SoftUpdate(loss, tau=0.005)
    optimizer = torch.optim.Adam(loss.parameters(), lr=config.learning_rate, fused=True)
    buffer = TensorDictReplayBuffer(
        storage=LazyTensorStorage(config.total_frames),
        sampler=sampler,
        batch_size=config.batch_size,
    )
    collector = Collector(
        make_env(config),
        actor,
        frames_per_batch=config.frames_per_batch,
        total_frames=config.total_frames,
        init_random_frames=config.random_frames,
        auto_register_policy_transforms=False,  # the actor has no state to reset
    )
    result, start = 0.0, time.perf_counter()
    for frames, data in enumerate(collector, 1):
        buffer.extend(data.reshape(-1).exclude("loc", "scale", "collector"))
        if len(buffer) < config.random_frames:
            continue
        for _ in range(config.frames_per_batch):
            losses = loss(buffer.sample())
            if annealing is not None:
                annealing.step()
            (losses["loss_actor"] + losses["loss_qvalue"] + losses["loss_alpha"]).backward()
            optimizer.step()
            optimizer.zero_grad()
            target_updater.step()
        if frames % 20 == 0 or frames * config.frames_per_batch >= config.total_frames:
            result = evaluate(env, actor)
            seconds = time.perf_counter() - start
            print(f"{frames * config.frames_per_batch:7d} frames {seconds:6.0f} s {result:9.1f}")
    collector.shutdown()
    return result


if __name__ == "__main__":
    logging.getLogger("torchrl").setLevel(logging.WARNING)
    main(tyro.cli(Config))
