"""What a TQC update, a replay sample and a transition cost, beside TorchRL, sb3-contrib and BLAS.

    python benchmarks/bench_learner.py                 # the whole table, about five minutes
    python benchmarks/bench_learner.py --rounds 5 --no-replay

An update is the whole step: sampling, losses, gradients, Adam, target networks. All learners take
turns within each round, so that a busy machine hits them alike; times are medians (fastest round
in brackets) and factors are medians of the factors within a round. On a machine that others use,
`--clock cpu --threads 1` counts this process's own time only. "matmuls" are the bare matrix
products of one update (actor forward twice and backward once, critics forward three times,
backward once for their parameters and once for the action), as `torch.bmm` into memory that is
there already.
"""

import contextlib
import io
import itertools
import logging
import statistics
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import gymnasium as gym
import numpy as np
import torch
import tyro
from tensordict import TensorDict
from tensordict.nn import NormalParamExtractor, TensorDictModule
from torch import nn
from torchrl.data import Bounded, LazyTensorStorage, RandomSampler, TensorDictReplayBuffer
from torchrl.envs import GymWrapper
from torchrl.modules import MLP, ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.objectives import SoftUpdate, TQCLoss as TorchRLTQCLoss

from modpush.agents import TQCConfig, TQCLoss, make_tqc
from modpush.encoders import ConvEncoder, DepthVAE, Encode, VAELoss
from modpush.replay import (
    AttentiveSampler,
    PrioritizedSampler,
    ReplayConfig,
    make_replay_buffer,
)

OBS, ACT, ATOMS, CRITICS = 49, 3, 25, 2
Step = Callable[[], object]


@dataclass(frozen=True)
class Args:
    """What is measured."""

    rounds: int = 15
    """Number of rounds; each learner takes one step in a round."""
    threads: tuple[int, ...] = (1, 2)
    """Numbers of torch threads to measure with."""
    sizes: tuple[tuple[tuple[int, ...], int], ...] = (
        ((512, 256, 128), 512),
        ((512, 256, 128), 256),
        ((256, 256), 256),
    )
    """Hidden sizes and batch size of each row."""
    clock: Literal["wall", "cpu"] = "wall"
    """Elapsed time, or this process's CPU time over all its threads."""
    replay: bool = True
    """Also measure sampling from a million transitions, and memory (needs 1.5 GB)."""
    out: Path | None = None
    """File that the tables are also written to."""


class Dummy(gym.Env):
    """Spaces of the pushing task without the task."""

    observation_space = gym.spaces.Box(-10, 10, (OBS,), np.float32)
    action_space = gym.spaces.Box(-1, 1, (ACT,), np.float32)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return np.zeros(OBS, np.float32), {}

    def step(self, action):
        return np.zeros(OBS, np.float32), 0.0, False, False, {}


def transitions(size: int) -> TensorDict:
    flags = torch.zeros(size, 1, dtype=torch.bool)
    after = {"observation": torch.randn(size, OBS), "reward": torch.randn(size, 1)}
    after |= {"done": flags, "terminated": flags.clone()}
    now = {"observation": torch.randn(size, OBS), "action": torch.rand(size, ACT) * 2 - 1}
    return TensorDict({**now, "next": after}, batch_size=[size])


def ours(hidden: tuple[int, ...], batch: int, sampler: str, **config) -> Step:
    agent = make_tqc(
        TQCConfig(hidden_sizes=hidden, batch_size=batch, **config), GymWrapper(Dummy())
    )
    buffer = make_replay_buffer(
        ReplayConfig(capacity=20_000, batch_size=batch, sampler=sampler, device=agent.config.device)
    )
    buffer.extend(transitions(20_000).to(agent.config.device))
    return lambda: agent.update(buffer.sample())


def with_torchrls_networks(loss_class: type, hidden: tuple[int, ...], batch: int) -> Step:
    """TorchRL's own networks, buffer, optimizer and loop; only the loss's class differs."""
    actor = ProbabilisticActor(
        TensorDictModule(
            nn.Sequential(
                MLP(
                    in_features=OBS,
                    out_features=2 * ACT,
                    num_cells=hidden,
                    activation_class=nn.ReLU,
                ),
                NormalParamExtractor(),
            ),
            in_keys=["observation"],
            out_keys=["loc", "scale"],
        ),
        in_keys=["loc", "scale"],
        spec=Bounded(-1, 1, (ACT,)),
        distribution_class=TanhNormal,
    )
    critics = [
        ValueOperator(
            MLP(
                in_features=OBS + ACT,
                out_features=ATOMS,
                num_cells=hidden,
                activation_class=nn.ReLU,
            ),
            in_keys=["observation", "action"],
        )
        for _ in range(CRITICS)
    ]
    loss = loss_class(actor, critics, num_qvalue_nets=CRITICS)
    loss.make_value_estimator(gamma=0.98)
    updater = SoftUpdate(loss, tau=0.005)
    parameters = [p for p in loss.parameters() if p.requires_grad]
    optimizer = torch.optim.Adam(parameters, lr=1e-4, fused=True)
    buffer = TensorDictReplayBuffer(
        storage=LazyTensorStorage(20_000), sampler=RandomSampler(), batch_size=batch
    )
    buffer.extend(transitions(20_000))

    def step() -> None:
        losses = loss(buffer.sample())
        (losses["loss_actor"] + losses["loss_qvalue"] + losses["loss_alpha"]).backward()
        optimizer.step()
        optimizer.zero_grad()
        updater.step()

    return step


def sb3(hidden: tuple[int, ...], batch: int) -> Step:
    from sb3_contrib import TQC
    from stable_baselines3.common.logger import configure

    model = TQC(
        "MlpPolicy",
        Dummy(),
        buffer_size=20_000,
        batch_size=batch,
        policy_kwargs={"net_arch": list(hidden), "n_critics": CRITICS, "n_quantiles": ATOMS},
        device="cpu",
    )
    model.set_logger(configure(None, []))
    data = transitions(20_000).numpy()
    buffer = model.replay_buffer
    buffer.observations[:, 0] = data["observation"]
    buffer.next_observations[:, 0] = data["next"]["observation"]
    buffer.actions[:, 0] = data["action"]
    buffer.rewards[:] = data["next"]["reward"]
    buffer.full = True
    return lambda: model.train(1, batch)


def matmuls(hidden: tuple[int, ...], batch: int) -> Step:
    """The matrix products of one update and nothing else."""
    products = []

    def network(count: int, sizes: list[int], *, parameters: bool, inputs: bool, backward: bool):
        pairs = list(itertools.pairwise(sizes))
        for i, o in pairs:
            products.append((torch.randn(count, batch, i), torch.randn(count, o, i).mT))
        for layer, (i, o) in enumerate(pairs if backward else []):
            gradient = torch.randn(count, batch, o)
            if parameters:
                products.append((gradient.mT, torch.randn(count, batch, i)))
            if layer or inputs:
                products.append((gradient, torch.randn(count, o, i)))

    actor, critic = [OBS, *hidden, 2 * ACT], [OBS + ACT, *hidden, ATOMS]
    network(1, actor, parameters=False, inputs=False, backward=False)  # targets
    network(CRITICS, critic, parameters=False, inputs=False, backward=False)
    network(CRITICS, critic, parameters=True, inputs=False, backward=True)  # critics
    network(1, actor, parameters=True, inputs=False, backward=True)  # actor
    network(CRITICS, critic, parameters=False, inputs=True, backward=True)
    outputs = [torch.bmm(a, b) for a, b in products]

    def step() -> None:
        for (a, b), out in zip(products, outputs, strict=True):
            torch.bmm(a, b, out=out)

    return step


def race(
    steps: dict[str, Step], args: Args, rounds: int | None = None, warmup: int = 3
) -> dict[str, list[float]]:
    """Milliseconds of each step in each round, taken in turns."""
    now = time.perf_counter if args.clock == "wall" else time.process_time
    for step in steps.values():
        for _ in range(warmup):
            step()
    times: dict[str, list[float]] = {name: [] for name in steps}
    for _ in range(args.rounds if rounds is None else rounds):
        for name, step in steps.items():
            start = now()
            step()
            if torch.cuda.is_available():
                torch.cuda.synchronize()
            times[name].append(1e3 * (now() - start))
    return times


def factor(times: dict[str, list[float]], slow: str, fast: str) -> float:
    ratios = [a / b for a, b in zip(times[slow], times[fast], strict=True)]
    return statistics.median(ratios)


def updates(args: Args) -> str:
    names = [
        "matmuls",
        "ours",
        "ours in bfloat16",
        "ours attentive",
        "ours in TorchRL's nets",
        "TorchRL",
        "sb3",
    ]
    lines = [
        "| networks, batch | threads | " + " | ".join(f"{n} [ms]" for n in names) + " | sb3 / ours "
        "| TorchRL / ours | TorchRL / ours in its nets | ours / matmuls "
        "| ours / ours in bfloat16 |",
        "|" + "---|" * (len(names) + 7),
    ]
    for hidden, batch in args.sizes:
        for threads in args.threads:
            torch.set_num_threads(threads)
            steps = {
                "matmuls": matmuls(hidden, batch),
                "ours": ours(hidden, batch, "uniform"),
                "ours in bfloat16": ours(hidden, batch, "uniform", precision="bfloat16"),
                "ours attentive": ours(hidden, batch, "attentive"),
                "ours in TorchRL's nets": with_torchrls_networks(TQCLoss, hidden, batch),
                "TorchRL": with_torchrls_networks(TorchRLTQCLoss, hidden, batch),
                "sb3": sb3(hidden, batch),
            }
            times = race(steps, args)
            factors = [
                factor(times, "sb3", "ours"),
                factor(times, "TorchRL", "ours"),
                factor(times, "TorchRL", "ours in TorchRL's nets"),
                factor(times, "ours", "matmuls"),
                factor(times, "ours", "ours in bfloat16"),
            ]
            cells = [f"{list(hidden)}, {batch}", str(threads)]
            cells += [f"{statistics.median(times[n]):.1f} ({min(times[n]):.1f})" for n in names]
            lines.append("| " + " | ".join(cells + [f"{value:.2f}" for value in factors]) + " |")
            print(lines[-1], flush=True)
    return "\n".join(lines)


def encoders(args: Args) -> str:
    """Encoders of images in both precisions, on one thread."""
    torch.set_num_threads(1)
    windows = torch.rand(256, 1, 64, 64)
    encode, trained, losses = Encode(DepthVAE.from_pretrained()), ConvEncoder(), VAELoss(DepthVAE())
    optimizer = torch.optim.Adam(losses.parameters(), fused=True)

    def train_vae() -> None:
        found = losses(TensorDict(window=windows))
        (found["loss_reconstruction"] + found["loss_kl"]).backward()
        optimizer.step()
        optimizer.zero_grad()

    work: dict[str, Step] = {
        "`Encode`, the autoencoder, 32 windows": lambda: encode(TensorDict(window=windows[:32])),
        "`ConvEncoder`, forward and backward, 256": lambda: trained(windows).sum().backward(),
        "a step of the autoencoder's training, 256": train_vae,
    }

    def reduced(step: Step) -> Step:
        def call() -> None:
            with torch.autocast("cpu", torch.bfloat16):
                step()

        return call

    lines = ["| encoders | float32 [ms] | bfloat16 [ms] | float32 / bfloat16 |", "|" + "---|" * 4]
    for name, step in work.items():
        times = race({"float32": step, "bfloat16": reduced(step)}, args)
        cells = [f"{statistics.median(times[n]):.2f} ({min(times[n]):.2f})" for n in times]
        ratio = factor(times, "float32", "bfloat16")
        lines.append(f"| {name} | " + " | ".join(cells) + f" | {ratio:.2f} |")
    return "\n".join(lines)


def gpu(args: Args) -> str:
    if not torch.cuda.is_available():
        return "No CUDA device: no GPU rows."
    lines = ["| networks, batch | eager [ms] | compiled [ms] | CUDA graph [ms] |", "|" + "---|" * 4]
    for hidden, batch in args.sizes:
        modes = ("eager", "compile", "cudagraph")
        steps = {m: ours(hidden, batch, "uniform", device="cuda", execution=m) for m in modes}
        times = race(steps, args, 20 * args.rounds, warmup=20)
        cells = [f"{statistics.median(times[m]):.2f}" for m in modes]
        lines.append(f"| {list(hidden)}, {batch} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def replay(args: Args) -> str:
    """Sampling 512 of a million."""
    torch.set_num_threads(1)
    capacity = 1_000_000
    storage = LazyTensorStorage(capacity)
    samplers = {
        "uniform": RandomSampler(),
        "attentive, k = 4": AttentiveSampler(4),
        "attentive, k = 4, 8 queries": AttentiveSampler(4, num_queries=8),
        "prioritized": PrioritizedSampler(capacity, alpha=0.6, beta=0.4),
    }
    buffers = {
        name: TensorDictReplayBuffer(storage=storage, sampler=sampler, batch_size=512)
        for name, sampler in samplers.items()
    }
    for _ in range(20):
        buffers["uniform"].extend(transitions(capacity // 20))
    buffers["prioritized"].update_priority(torch.arange(capacity), torch.rand(capacity))
    steps = {n: b.sample for n, b in buffers.items()}

    def sample_and_update() -> None:
        batch = buffers["prioritized"].sample()
        buffers["prioritized"].update_priority(batch["index"], torch.rand(512))

    steps["prioritized, and its new priorities"] = sample_and_update
    times = race(steps, args, 20 * args.rounds, warmup=20)
    lines = ["| sample of 512 from 1e6, 1 thread | ms | times uniform |", "|---|---|---|"]
    for name in steps:
        ratio = factor(times, name, "uniform")
        spread = f"{statistics.median(times[name]):.2f} ({min(times[name]):.2f})"
        lines.append(f"| {name} | {spread} | {ratio:.2f} |")
    return "\n".join(lines)


def main(args: Args) -> None:
    tables = [updates(args), encoders(args), gpu(args)]
    if args.replay:
        tables.append(replay(args))
    header = f"{args.rounds} rounds, {args.clock} time; milliseconds: median (fastest round)."
    text = "\n\n".join([header, *tables]) + "\n"
    print("\n" + text)
    if args.out is not None:
        args.out.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    warnings.filterwarnings("ignore")
    logging.getLogger("torchrl").setLevel(logging.WARNING)
    with contextlib.redirect_stderr(io.StringIO()):
        main(tyro.cli(Args))
