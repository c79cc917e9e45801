"""Learning evidence: TQC with uniform and attentive replay, and sb3-contrib's TQC beside it.

One run of one seed, appended to `runs/learner_curves.csv`:

    python benchmarks/learning_curves.py run --task pendulum --learner attentive --seed 0

and the picture of all runs so far:

    python benchmarks/learning_curves.py plot
"""

import csv
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import gymnasium as gym
import numpy as np
import point_pusher  # noqa: F401 (registers the task)
import torch
import tyro
from tensordict import TensorDict
from torch import Tensor
from torchrl.data import LazyTensorStorage, RandomSampler, TensorDictReplayBuffer
from torchrl.data.replay_buffers.scheduler import LinearScheduler
from torchrl.envs import ExplorationType, GymEnv, set_exploration_type

from modpush.agents import TQCAgent, TQCConfig, make_tqc
from modpush.replay import AttentiveSampler

CURVES = Path("runs/learner_curves.csv")
PICTURE = Path(__file__).parent.parent / "docs" / "results" / "learner_curves.png"
EVALUATION_EPISODES = 20
ENVS = {"pendulum": "Pendulum-v1", "point_pusher": "PointPusher-v0"}
MAX_EPISODE_STEPS = {"pendulum": 200, "point_pusher": 60}


@dataclass(frozen=True)
class Run:
    """One seed of one learner on one task."""

    task: Literal["pendulum", "point_pusher"] = "pendulum"
    learner: Literal["uniform", "attentive", "attentive_annealed", "sb3"] = "uniform"
    """Our learner with either sampler, or sb3-contrib's TQC (uniform)."""
    seed: int = 0
    steps: int = 8000
    evaluate_every: int = 500
    hidden_sizes: tuple[int, ...] = (128, 128)
    batch_size: int = 128
    learning_rate: float = 1e-3
    learning_starts: int = 1000
    alpha_init: float = 1.0
    """Entropy temperature at the start."""
    k: float = 4
    """Candidates per kept transition of the attentive learners."""
    out: Path = CURVES


@dataclass(frozen=True)
class Plot:
    """Draw every run in the table."""

    table: Path = CURVES
    out: Path = PICTURE


Policy = Callable[[np.ndarray], np.ndarray]


def main(command: Annotated[Run | Plot, tyro.conf.subcommand()]) -> None:
    if isinstance(command, Plot):
        plot(command)
        return
    torch.set_num_threads(1)
    torch.manual_seed(command.seed)
    np.random.seed(command.seed)  # noqa: NPY002 (sb3 draws from it)
    start = time.perf_counter()
    for step, policy in (learn_sb3 if command.learner == "sb3" else learn_ours)(command):
        returns, success = evaluate(command.task, policy)
        seconds = time.perf_counter() - start
        row = [command.task, command.learner, command.alpha_init, command.seed, step]
        row += [round(returns, 2), round(success, 3), round(seconds, 1)]
        print(*row, flush=True)
        append(command.out, row)


def learn_ours(run: Run) -> Iterator[tuple[int, Policy]]:
    env = gym.make(ENVS[run.task])
    config = TQCConfig(
        hidden_sizes=run.hidden_sizes,
        batch_size=run.batch_size,
        actor_lr=run.learning_rate,
        critic_lr=run.learning_rate,
        alpha_lr=run.learning_rate,
        alpha_init=run.alpha_init,
    )
    agent = make_tqc(config, GymEnv(ENVS[run.task]))
    annealed = run.learner == "attentive_annealed"
    sampler = RandomSampler() if run.learner == "uniform" else AttentiveSampler(run.k)
    annealing = LinearScheduler(sampler, "k", 1.0, run.steps) if annealed else None
    buffer = TensorDictReplayBuffer(
        storage=LazyTensorStorage(run.steps), sampler=sampler, batch_size=run.batch_size
    )
    scale = torch.from_numpy(env.action_space.high)
    observation, _ = env.reset(seed=run.seed)
    env.action_space.seed(run.seed)
    for step in range(1, run.steps + 1):
        if step <= run.learning_starts:
            action = torch.from_numpy(env.action_space.sample())
        else:
            action = act(agent, torch.from_numpy(observation), ExplorationType.RANDOM)
        following, reward, terminated, truncated, _ = env.step(action.numpy())
        buffer.add(transition(observation, action, following, reward, terminated, truncated))
        observation = env.reset()[0] if terminated or truncated else following
        if step > run.learning_starts:
            agent.update(buffer.sample())
            if annealing is not None:
                annealing.step()
        if step % run.evaluate_every == 0:
            yield step, lambda o: act(agent, torch.from_numpy(o)).clamp(-scale, scale).numpy()


def act(
    agent: TQCAgent, observation: Tensor, mode: ExplorationType = ExplorationType.DETERMINISTIC
) -> Tensor:
    data = TensorDict({"observation": observation}, batch_size=observation.shape[:-1])
    with torch.no_grad(), set_exploration_type(mode):
        return agent.actor(data)["action"]


def transition(
    observation: np.ndarray,
    action: Tensor,
    following: np.ndarray,
    reward: float,
    terminated: bool,
    truncated: bool,
) -> TensorDict:
    after = {
        "observation": torch.from_numpy(following),
        "reward": torch.tensor([reward], dtype=torch.float32),
        "terminated": torch.tensor([terminated]),
        "done": torch.tensor([terminated or truncated]),
    }
    now = {"observation": torch.from_numpy(observation), "action": action}
    return TensorDict({**now, "next": TensorDict(after)})


def learn_sb3(run: Run) -> Iterator[tuple[int, Policy]]:
    from sb3_contrib import TQC

    model = TQC(
        "MlpPolicy",
        gym.make(ENVS[run.task]),
        learning_rate=run.learning_rate,
        buffer_size=run.steps,
        learning_starts=run.learning_starts,
        ent_coef=f"auto_{run.alpha_init}",
        batch_size=run.batch_size,
        tau=TQCConfig.tau,
        gamma=TQCConfig.gamma,
        top_quantiles_to_drop_per_net=TQCConfig.top_quantiles_to_drop_per_net,
        policy_kwargs={
            "net_arch": list(run.hidden_sizes),
            "n_quantiles": TQCConfig.num_quantiles,
            "n_critics": TQCConfig.num_critics,
        },
        seed=run.seed,
    )
    for step in range(run.evaluate_every, run.steps + 1, run.evaluate_every):
        model.learn(run.evaluate_every, reset_num_timesteps=False)
        yield step, lambda observation: model.predict(observation, deterministic=True)[0]


def evaluate(task: str, policy: Policy) -> tuple[float, float]:
    """Mean return and share of successes of greedy episodes, the same ones every time."""
    envs = [gym.make(ENVS[task]) for _ in range(EVALUATION_EPISODES)]
    observations = np.stack([env.reset(seed=10_000 + i)[0] for i, env in enumerate(envs)])
    returns, alive = np.zeros(len(envs)), np.ones(len(envs), bool)
    success = np.zeros(len(envs), bool)
    for _ in range(MAX_EPISODE_STEPS[task]):
        actions = policy(observations)
        for i in np.flatnonzero(alive):
            observations[i], reward, terminated, truncated, info = envs[i].step(actions[i])
            returns[i] += reward
            success[i] |= info.get("success", False)
            alive[i] = not (terminated or truncated)
    return float(returns.mean()), float(success.mean())


HEADER = ["task", "learner", "alpha_init", "seed", "step", "return", "success", "seconds"]


def append(path: Path, row: list) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    new = not path.exists()
    with path.open("a", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        if new:
            writer.writerow(HEADER)
        writer.writerow(row)


def plot(command: Plot) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    with command.table.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        row["learner"] += f", initial temperature {row['alpha_init']}"
    tasks = sorted({row["task"] for row in rows})
    figure, axes = plt.subplots(1, len(tasks), figsize=(6 * len(tasks), 4), squeeze=False)
    for axis, task in zip(axes[0], tasks, strict=True):
        learners = sorted({row["learner"] for row in rows if row["task"] == task})
        for color, learner in enumerate(learners):
            mine = [row for row in rows if (row["task"], row["learner"]) == (task, learner)]
            steps = sorted({int(row["step"]) for row in mine})
            values = [[float(r["return"]) for r in mine if int(r["step"]) == s] for s in steps]
            mean = [np.mean(value) for value in values]
            axis.plot(steps, mean, color=f"C{color}", label=f"{learner} ({len(values[0])} seeds)")
            low, high = [min(v) for v in values], [max(v) for v in values]
            axis.fill_between(steps, low, high, color=f"C{color}", alpha=0.15)
        axis.set(title=task, xlabel="environment steps", ylabel="greedy return")
        axis.legend()
    figure.tight_layout()
    figure.savefig(command.out, dpi=110)


if __name__ == "__main__":
    warnings.filterwarnings("ignore", category=DeprecationWarning)
    main(tyro.cli(Annotated[Run | Plot, tyro.conf.arg(name="")]))
