"""Learners of TQC in the same training: modpush's, TorchRL's and sb3-contrib's, to the same success.

    python benchmarks/compare_learners.py                          # seed 0, some three minutes a learner
    python benchmarks/compare_learners.py --learners ours sb3 --seeds 0 1 2

Everything but the update is `modpush train`'s, on two cores: scenes, scripted first actions, the
buffer with its sampler, mirror images and n-step returns, the averaged actor, the held-out episodes.
All learners of a seed begin with the same weights. A run ends at the first evaluation with the success
that is asked for. TorchRL's loss has modpush's networks and optimizer, sb3-contrib's `TQC.train` its
own, and is given each batch. With "ours" updates are in bfloat16 where the processor has it, and scenes
act in it; the other learners are in float32. The time of an update is that of the call, without the
sample.
"""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import statistics
import tempfile
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import gymnasium as gym
import numpy as np
import torch
import tyro
from sb3_contrib import TQC
from stable_baselines3.common.logger import configure
from stable_baselines3.common.type_aliases import ReplayBufferSamples
from tensordict import TensorDict, TensorDictBase
from torch import nn
from torchrl.objectives import TQCLoss as TorchRLTQCLoss

from modpush.agents import TQCAgent, TQCConfig
from modpush.agents.tqc.factories import LearnerSpecs, entropy_settings
from modpush.training import TRAIN_PRESETS, TrainConfig, Trainer

Learner = Literal["ours", "ours in float32", "torchrl", "sb3"]


@dataclass(frozen=True, kw_only=True)
class CompareConfig:
    """What is compared."""

    learners: tuple[Learner, ...] = ("ours", "ours in float32", "torchrl", "sb3")
    """Learners, one run for each and each seed."""
    seeds: tuple[int, ...] = (0,)
    """Seeds of the runs."""
    preset: str = "cpu"
    """Training preset."""
    success: float = 0.98
    """Success of the held-out episodes at which a run ends."""
    total_steps: int = 200_000
    """Environment steps after which a run ends in any case."""
    evaluate_every: int = 12_500
    """Environment steps between two evaluations."""


class TimedUpdate:
    """Calls an update and keeps the time of each call, `seconds`."""

    def __init__(self, update: Callable[[TensorDictBase], TensorDict]) -> None:
        self.update, self.seconds = update, list[float]()

    def __call__(self, batch: TensorDictBase) -> TensorDict:
        began = time.perf_counter()
        result = self.update(batch)
        self.seconds.append(time.perf_counter() - began)
        return result


def torchrl_loss(config: TQCConfig, actor: Any, critics: Any, specs: LearnerSpecs) -> Any:
    """TorchRL's loss with modpush's networks."""
    loss = TorchRLTQCLoss(
        actor,
        critics,
        num_qvalue_nets=len(critics),
        top_quantiles_to_drop_per_net=config.top_quantiles_to_drop_per_net,
        skip_done_states=config.skip_done_states,
        **entropy_settings(config, specs),
    )
    loss.set_keys(action=specs.action_key)
    loss.make_value_estimator(gamma=config.gamma)
    return loss


class Sb3Update:
    """`TQC.train` of sb3-contrib for a given batch; `copy_actor` gives its actor to an agent."""

    def __init__(self, agent: TQCAgent, observation_dim: int) -> None:
        config = agent.config
        self.agent, self.gamma = agent, config.gamma
        self.model = TQC(
            "MlpPolicy",
            _spaces(observation_dim, agent.actor.spec["action"].shape[-1]),
            buffer_size=1,
            gamma=config.gamma,
            tau=config.tau,
            ent_coef=f"auto_{config.alpha_init}",
            top_quantiles_to_drop_per_net=config.top_quantiles_to_drop_per_net,
            policy_kwargs={
                "net_arch": list(config.hidden_sizes),
                "n_critics": config.num_critics,
                "n_quantiles": config.num_quantiles,
            },
            device="cpu",
        )
        self.model.set_logger(configure(None, []))
        self._set_learning_rates(config)
        self._start_with_the_agents_weights()

    def _set_learning_rates(self, config: TQCConfig) -> None:
        """One for each optimizer, where sb3 has a single one and sets it anew in each call."""
        model = self.model
        for optimizer, rate in (
            (model.actor.optimizer, config.actor_lr),
            (model.critic.optimizer, config.critic_lr),
            (model.ent_coef_optimizer, config.alpha_lr),
        ):
            optimizer.param_groups[0]["lr"] = rate
        model._update_learning_rate = lambda *_: None

    def _start_with_the_agents_weights(self) -> None:
        for layer, mine in zip(self._actor_layers(), _linears(self.agent.actor), strict=True):
            for tensor, given in zip(layer, (mine.weight, mine.bias), strict=True):
                rows = given.data.split([len(part) for part in tensor])
                for part, values in zip(tensor, rows, strict=True):
                    part.data.copy_(values)
        # The loss trains a stacked copy of the agent's critics.
        stacked = self.agent.loss.qvalue_network_params
        weights = [value for key, value in sorted(stacked.items(True, True)) if key[-1] == "weight"]
        biases = [value for key, value in sorted(stacked.items(True, True)) if key[-1] == "bias"]
        for number, critic in enumerate(self.model.critic.q_networks):
            for layer, weight, bias in zip(_linears(critic), weights, biases, strict=True):
                layer.weight.data.copy_(weight.data[number])
                layer.bias.data.copy_(bias.data[number])
        self.model.critic_target.load_state_dict(self.model.critic.state_dict())

    def _actor_layers(self) -> list[tuple[list[nn.Parameter], list[nn.Parameter]]]:
        """Weights and biases of each layer; the last of modpush's is two of sb3's, one on the other."""
        actor = self.model.actor
        layers = [[layer] for layer in _linears(actor.latent_pi)] + [[actor.mu, actor.log_std]]
        return [([x.weight for x in layer], [x.bias for x in layer]) for layer in layers]

    def __call__(self, batch: TensorDictBase) -> TensorDict:
        after, one = batch["next"], torch.ones(len(batch), 1)
        sample = ReplayBufferSamples(
            batch["observation"],
            batch["action"],
            after["observation"],
            after["terminated"].float(),
            after["reward"],
            self.gamma ** batch.get("steps_to_next_obs", one).float().reshape(-1, 1),
        )
        self.model.replay_buffer.sample = lambda *_, **__: sample
        self.model.train(1, len(batch))
        values = self.model.logger.name_to_value
        return TensorDict({"loss_qvalue": torch.tensor(float(values["train/critic_loss"]))})

    def copy_actor(self) -> None:
        """Copy the actor's weights into the agent."""
        for layer, mine in zip(self._actor_layers(), _linears(self.agent.actor), strict=True):
            for tensor, own in zip(layer, (mine.weight, mine.bias), strict=True):
                own.data.copy_(torch.cat([part.data for part in tensor]))


def _linears(module: nn.Module) -> list[nn.Linear]:
    return [layer for layer in module.modules() if isinstance(layer, nn.Linear)]


def _spaces(observations: int, actions: int) -> gym.Env:
    """An environment that has spaces and nothing else."""
    env: gym.Env = gym.Env()
    env.observation_space = gym.spaces.Box(-np.inf, np.inf, (observations,), np.float32)
    env.action_space = gym.spaces.Box(-1.0, 1.0, (actions,), np.float32)
    return env


def install(learner: Learner, trainer: Trainer) -> TimedUpdate:
    """Replace the update of a run by a timed one, and by sb3's if that is the learner."""
    agent = trainer.learner.agent
    if learner != "sb3":
        timed = TimedUpdate(agent.update)
        trainer.learner.agent = replace(agent, update=timed)
        return timed
    update = Sb3Update(agent, trainer.learner.observation_dim)
    timed = TimedUpdate(update)

    def update_and_copy(batch: TensorDictBase) -> TensorDict:
        result = timed(batch)
        update.copy_actor()
        return result

    trainer.learner.agent = replace(agent, update=update_and_copy)
    return timed


def run(learner: Learner, config: TrainConfig, success: float) -> dict[str, Any]:
    """Train until the held-out episodes succeed; median time of an update [ms], and all evaluations."""
    precision = "float32" if learner != "ours" else "auto"
    config = replace(config, tqc=replace(config.tqc, precision=precision))
    parts = {"loss": torchrl_loss} if learner == "torchrl" else None
    with tempfile.TemporaryDirectory() as folder:
        trainer = Trainer(config, Path(folder) / "run", parts=parts)
        timed = install(learner, trainer)
        evaluate = trainer._evaluate

        def evaluate_and_end() -> None:
            evaluate()
            rows = trainer.log.evaluations
            trainer.finished |= bool(rows) and rows[-1]["success"] >= success

        trainer._evaluate = evaluate_and_end  # type: ignore[method-assign]
        trainer.run()
        evaluations = trainer.log.evaluations
    return {"ms": 1e3 * statistics.median(timed.seconds), "evaluations": evaluations}


def first(evaluations: list[dict[str, float]], success: float) -> str:
    """Steps, updates and minutes of the first evaluation with a success; a dash if there is none."""
    for row in evaluations:
        if row["success"] >= success:
            return f"{row['step']:,} steps, {row['updates']:,} updates, {row['minutes']:.1f} min"
    return "–"


def main(config: CompareConfig) -> None:
    torch.set_num_threads(1)
    preset = replace(
        TRAIN_PRESETS[config.preset],
        total_steps=config.total_steps,
        evaluate_every=config.evaluate_every,
        checkpoint_every=10**9,
        progress=False,
    )
    print("| seed | learner | update [ms] | success 0.9 | 0.95 | 0.98 |\n|---|---|---|---|---|---|")
    for seed in config.seeds:
        for learner in config.learners:
            found = run(learner, replace(preset, seed=seed), config.success)
            passed = " | ".join(first(found["evaluations"], s) for s in (0.9, 0.95, 0.98))
            print(f"| {seed} | {learner} | {found['ms']:.1f} | {passed} |", flush=True)


if __name__ == "__main__":
    warnings.filterwarnings("ignore", message="Failed to find system libvulkan")
    main(tyro.cli(CompareConfig, description=__doc__))
