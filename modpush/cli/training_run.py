"""A training run from the command line: its settings, its folder and its learning curve."""

import argparse
import sys
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, field, is_dataclass, replace
from pathlib import Path
from typing import Any, Literal

import pandas as pd
import tyro

from modpush._kernels import announce_compiling
from modpush._types import Count, FilePath
from modpush._validation import checked, from_plain
from modpush.files import parse_yaml, reading
from modpush.parts import check_allowed
from modpush.training import TRAIN_PRESETS, TrainConfig, Trainer
from modpush.training.curve import draw_curve
from modpush.training.run_folder import RunFolder

SHORT_FORMS = {
    "--init-from": "--train.init-from",
    "--collector": "--train.collector",
    "--num-collectors": "--train.num-collectors",
    "--minutes": "--train.max-minutes",
}
"""Short forms of options, and what they stand for."""


@checked
class RunConfig:
    """A training run and its folder."""

    train: TrainConfig = field(default_factory=TrainConfig)
    """Settings of the training run."""
    out: FilePath = Path("runs/train")
    """Folder of the run; `modpush train PRESET` writes to runs/train_PRESET by default."""
    reward_term: Mapping[str, float] = field(default_factory=dict)
    """Weights of your own reward terms, each as "module:function" and a number; they are added to
    `train.env.reward.weights`."""
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
        f"steps. {_when_passed(folder)}Wrote {folder.best_agent} and {folder.curve}."
    )
    return best


def _when_passed(folder: RunFolder) -> str:
    """Minutes of training after which the held-out success was first 0.95 and 0.98."""
    table = pd.read_csv(folder.evaluations)
    first = {level: table[table["success"] >= level]["minutes"] for level in (0.95, 0.98)}
    passed = [f"{level:.2f} after {m.iloc[0]:.1f}" for level, m in first.items() if len(m)]
    return f"Success reached {' and '.join(passed)} minutes. " if passed else ""


def run_preset(arguments: Sequence[str]) -> None:
    """Train as the command line says, and say after an interrupt how to continue."""
    run = parse_run(arguments)
    try:
        train_agent(run)
    except KeyboardInterrupt:
        if RunFolder(run.out).checkpoints.latest() is None:
            print("\nStopped before the first checkpoint; start again with the same command.")
        else:
            print(f"\nStopped; a checkpoint is in {run.out}. Continue with --resume.")
        raise KeyboardInterrupt("") from None


def parse_run(arguments: Sequence[str]) -> RunConfig:
    """The run of a command line: a preset, changed by the file of `--config`, changed by the options.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If there is no such preset, or the file does not fit.
    """
    preset, *options = arguments or [""]
    if preset not in TRAIN_PRESETS:
        raise ValueError(f"expected a preset first, one of {[*TRAIN_PRESETS]}, got {preset!r}.")
    # The file decides the defaults of all other options, so that it is read before these are parsed.
    parser = argparse.ArgumentParser(f"modpush train {preset}", add_help=False, allow_abbrev=False)
    parser.add_argument("--config", type=Path)
    parser.add_argument("--allow", nargs="+", default=[])
    given, options = parser.parse_known_args(options)
    words = [option.partition("=") for option in options]
    options = [
        SHORT_FORMS.get(word.replace("_", "-"), word) + is_ + value for word, is_, value in words
    ]
    config = TRAIN_PRESETS[preset][1]
    if given.config is not None:
        config = _read_settings(given.config, config, given.allow)
    return tyro.cli(
        RunConfig,
        prog=f"modpush train {preset}",
        default=RunConfig(train=config, out=Path("runs") / f"train_{preset}"),
        args=options,
    )


def _read_settings(path: Path, config: TrainConfig, allow: Collection[str]) -> TrainConfig:
    """A configuration with the fields that a YAML file sets."""
    with reading(path, "--config"):
        settings = parse_yaml(path.read_bytes())
        if not isinstance(settings, Mapping):
            raise ValueError(f"expected fields of TrainConfig by name, got {settings!r}")
        check_allowed(f"--config: {path}", settings, allow)
        return from_plain(TrainConfig, _merged(config, settings))


def _merged(config: Any, changes: Mapping[str, Any]) -> dict[str, Any]:
    """A configuration as plain data with some fields replaced, those of nested ones singly."""
    data = {**asdict(config), **changes}
    for name, value in changes.items():
        nested = getattr(config, name, None)
        if isinstance(value, Mapping) and is_dataclass(nested):
            data[name] = _merged(nested, value)
    return data
