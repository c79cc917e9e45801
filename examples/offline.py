"""Learn from demonstrations alone: behaviour cloning, and TorchRL's IQL and CQL.

    modpush collect --policy small_cube --episodes 1000 --only-success
    python examples/offline.py                       # behaviour cloning
    python examples/offline.py --method bc iql cql   # all three, one after the other

Each method's policy is written as an agent's file, as training writes it: `modpush evaluate --policy
runs/offline/bc.safetensors` takes it. docs/demonstrations.md has what they reached.
"""

import time
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import torch
import tyro
from tensordict import TensorDict
from torch import nn
from torchrl.data import Bounded
from torchrl.modules import MLP, ProbabilisticActor, ValueOperator
from torchrl.objectives import BCLoss, CQLLoss, IQLLoss, LossModule, SoftUpdate
from tqdm import trange

from modpush.agents import make_actor
from modpush.data import Demonstrations, load_demonstrations
from modpush.evaluation import run_episodes
from modpush.recipes import save_agent
from modpush.replay import ReplayConfig, make_replay_buffer
from modpush.training import TrainConfig, held_out_scenarios


@dataclass(frozen=True, kw_only=True)
class Config:
    """Settings of the learning."""

    data: tyro.conf.Positional[Path] = Path("runs/demonstrations")
    """Folder of `modpush collect`."""
    method: tuple[Literal["bc", "iql", "cql"], ...] = ("bc",)
    """Methods, one after the other."""
    updates: int = 5000
    """Number of updates of each."""
    batch_size: int = 256
    """Number of transitions in an update."""
    hidden_sizes: tuple[int, ...] = (256, 256)
    """Widths of all networks' hidden layers."""
    learning_rate: float = 1e-3
    """Learning rate of Adam."""
    gamma: float = 0.98
    """Discount factor per step."""
    episodes: int = 120
    """Number of held-out episodes to evaluate on; none of an evaluation set."""
    seed: int = 0
    """Seed of networks and batches."""
    out: Path = Path("runs/offline")
    """Folder for the agents' files."""


def make_policy(config: Config, width: int) -> ProbabilisticActor:
    """The policy, as training makes it."""
    spec = Bounded(-1.0, 1.0, (3,), dtype=torch.float32)
    return make_actor(width, spec, config.hidden_sizes)


def make_loss(method: str, config: Config, policy: ProbabilisticActor, width: int) -> LossModule:
    """TorchRL's loss of a method."""

    def mlp(inputs: int) -> MLP:
        sizes = list(config.hidden_sizes)
        return MLP(in_features=inputs, out_features=1, num_cells=sizes, activation_class=nn.ReLU)

    if method == "bc":
        return BCLoss(policy)
    critic = ValueOperator(mlp(width + 3), in_keys=["observation", "action"])
    loss: LossModule
    if method == "iql":
        value = ValueOperator(mlp(width), in_keys=["observation"])
        loss = IQLLoss(policy, critic, value, temperature=3.0, expectile=0.7)
    else:
        loss = CQLLoss(policy, critic, action_spec=policy.spec["action"])
    loss.make_value_estimator(gamma=config.gamma)
    return loss


def learn(method: str, config: Config, transitions: TensorDict) -> ProbabilisticActor:
    """Update on batches of the demonstrations; nothing is simulated."""
    torch.manual_seed(config.seed)
    width = transitions["observation"].shape[-1]
    policy = make_policy(config, width)
    loss = make_loss(method, config, policy, width)
    updater = None if method == "bc" else SoftUpdate(loss, tau=0.005)
    replay = ReplayConfig(
        capacity=len(transitions), batch_size=config.batch_size, sampler="uniform"
    )
    buffer = make_replay_buffer(replay)
    buffer.extend(transitions)
    optimizer = torch.optim.Adam(loss.parameters(), lr=config.learning_rate)
    for _ in trange(config.updates, desc=method):
        batch = buffer.sample()
        # At the bounds, a tanh-squashed Gaussian has no density.
        batch["action"] = batch["action"].clamp(-0.999, 0.999)
        losses = loss(batch)
        sum(value for key, value in losses.items() if key.startswith("loss_")).backward()
        optimizer.step()
        optimizer.zero_grad()
        if updater is not None:
            updater.step()
    return policy.eval().requires_grad_(False)


def success_rate(
    config: Config, demonstrations: Demonstrations, policy: ProbabilisticActor
) -> float:
    """Share of held-out episodes that the policy solves, greedily."""
    held_out = TrainConfig(
        env=demonstrations.config, greedy_envs=0, evaluation_episodes=config.episodes
    )
    env = demonstrations.make_env(min(8, config.episodes))
    episodes = [*run_episodes(env, policy, enumerate(held_out_scenarios(held_out)))]
    env.close()
    return sum(episode.metrics.success for episode in episodes) / len(episodes)


def main(config: Config) -> dict[str, float]:
    """Learn with each method, evaluate it and write its agent; returns the success of each."""
    torch.set_num_threads(1)
    demonstrations = load_demonstrations(config.data)
    count, width = demonstrations.transitions["observation"].shape
    print(f"{len(demonstrations.episodes)} episodes, {count} transitions of {width} values")
    results: dict[str, float] = {}
    for method in config.method:
        start = time.perf_counter()
        policy = learn(method, config, demonstrations.transitions)
        seconds = time.perf_counter() - start
        results[method] = success_rate(config, demonstrations, policy)
        save_agent(
            config.out / f"{method}.safetensors",
            policy,
            demonstrations.config,
            hidden_sizes=config.hidden_sizes,
            observation_dim=width,
            fingerprint=demonstrations.fingerprint,
            metadata={"method": method, "updates": config.updates},
        )
        print(
            f"{method}: success {results[method]:.3f} of {config.episodes} held-out episodes, "
            f"{config.updates} updates in {seconds:.0f} s"
        )
    return results


if __name__ == "__main__":
    warnings.filterwarnings("ignore", message="Failed to find system libvulkan")
    main(tyro.cli(Config))
