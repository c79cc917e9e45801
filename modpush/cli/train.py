"""Train an agent: environment and learner each in their own process, on two cores.

    modpush train cpu --out runs/train            # the first part of `make train`, some tens of minutes
    modpush train cpu --out runs/train --resume   # continue after an interrupt
    modpush train refine --init-from runs/train --out runs/refine   # the second part: more careful
    modpush train smoke --out /tmp/smoke          # everything once, in some seconds
    modpush train cpu --out runs/rays --train.env.encoder rays --train.seed 1
    modpush train cpu --out runs/more --init-from runs/train   # start from another run's weights
    modpush train cpu --out runs/calm --reward-term my_lab:large_actions 0.2   # your own term
    modpush train cpu --out runs/wide --collector ray --num-collectors 8   # on a Ray cluster

The folder gets `config.yaml`, `log.csv`, `evaluations.csv` (greedy, on held-out episodes), `curve.png`,
`best_agent.safetensors` (give it to `modpush.load_agent` or `modpush evaluate --policy`),
`checkpoints/`, and what TensorBoard reads in `logs/`. Ctrl-C, SIGTERM and SIGHUP write a
checkpoint and stop.
"""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from pathlib import Path
from typing import Literal

import tyro

from modpush._types import Count, FilePath, Name, Positive
from modpush._validation import checked
from modpush.cli.compiling import announce_compiling
from modpush.training import TRAIN_PRESETS, TrainConfig, Trainer
from modpush.training.curve import draw_curve
from modpush.training.run_folder import RunFolder

__all__ = ["RunConfig", "main", "train_agent"]


@checked
class RunConfig:
    """A training run and its folder."""

    train: TrainConfig = field(default_factory=TrainConfig)
    """Settings of the training run."""
    out: FilePath = Path("runs/train")
    """Folder of the run."""
    init_from: Name | None = None
    """The same as `train.init_from`: start from the weights of an agent or a run."""
    collector: Literal["local", "ray"] | None = None
    """The same as `train.collector`: with "ray" the scenes act on a Ray cluster."""
    num_collectors: Count | None = None
    """The same as `train.num_collectors`."""
    reward_term: Mapping[str, float] = field(default_factory=dict)
    """Weights of your own reward terms, each as "module:function" and a number; they are added to
    `train.env.reward.weights`."""
    minutes: Positive | None = None
    """The same as `train.max_minutes`: end after so many minutes, like a completed run."""
    resume: bool = False
    """Resume the run in the folder from its newest checkpoint."""
    threads: Count = 1
    """Number of torch's threads in the learner's process. Updates of large networks and batches, as
    in `paper`, are faster with two or more; small ones are not. Sums are rounded differently with
    another number."""


def train_agent(run: RunConfig) -> dict[str, float]:
    """Train, and draw the learning curve. Ctrl-C, SIGTERM and SIGHUP end it with a checkpoint.

    On Linux the environment's process is forked, so call this before anything has run on several
    threads of torch or numba, or use `Trainer` itself.

    Returns:
        The best agent's means over the held-out episodes, a row of `evaluations.csv`.

    Raises:
        KeyboardInterrupt: After an interrupt, once the checkpoint is written.
    """
    announce_compiling()
    # Nothing has run in this process yet, so that the worker may share its libraries' memory.
    start_method: Literal["fork", "spawn"] = "fork" if sys.platform == "linux" else "spawn"
    config = run.train
    if run.init_from is not None:
        config = replace(config, init_from=run.init_from)
    if run.collector is not None:
        config = replace(config, collector=run.collector)
    if run.num_collectors is not None:
        config = replace(config, num_collectors=run.num_collectors)
    if run.minutes is not None:
        config = replace(config, max_minutes=run.minutes)
    if run.reward_term:
        reward = config.env.reward
        reward = replace(reward, weights={**reward.weights, **run.reward_term})
        config = replace(config, env=replace(config.env, reward=reward))
    trainer = Trainer(
        config, run.out, resume=run.resume, start_method=start_method, threads=run.threads
    )
    folder = trainer.folder
    try:
        best = trainer.run()
    finally:
        if folder.evaluations.exists():
            draw_curve([folder.path], folder.curve)
    if not best:
        print(f"{folder.path}: nothing was evaluated yet.")
        return best
    print(
        f"Best on the held-out episodes: success {best['success']:.3f}, SPL {best['spl']:.3f}, contact "
        f"{best['contact_rate']:.3f}, collisions {best['collision_rate']:.3f}, after {best['step']} "
        f"steps. Wrote {folder.best_agent} and {folder.curve}."
    )
    return best


def main(arguments: Sequence[str]) -> None:
    """`modpush train <arguments>`."""
    presets = {
        name: (text, RunConfig(train=config, out=Path("runs") / f"train_{name}"))
        for name, (text, config) in TRAIN_PRESETS.items()
    }
    run = tyro.extras.overridable_config_cli(
        presets, prog="modpush train", description=__doc__, args=[*arguments]
    )
    try:
        train_agent(run)
    except KeyboardInterrupt:
        if RunFolder(run.out).checkpoints.latest() is None:
            print("\nStopped before the first checkpoint; start again with the same command.")
        else:
            print(f"\nStopped; a checkpoint is in {run.out}. Continue with --resume.")
        raise KeyboardInterrupt("") from None
