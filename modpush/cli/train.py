"""Train an agent: environment and learner each in their own process, on two cores.

    modpush train cpu --out runs/train            # the first part of `make train`, ten to thirty minutes
    modpush train cpu --out runs/train --resume   # continue after an interrupt
    modpush train refine --init-from runs/train --out runs/refine   # the second part: more careful
    modpush train smoke --out /tmp/smoke          # everything once, in some seconds
    modpush train cpu --out runs/rays --train.env.encoder rays --train.seed 1
    modpush train cpu --out runs/more --init-from runs/train   # start from another run's weights
    modpush train cpu --out runs/calm --reward-term my_lab:large_actions 0.2   # your own term
    modpush train cpu --out runs/wide --collector ray --num-collectors 8   # on a Ray cluster

The folder gets `config.yaml`, `log.csv`, `evaluations.csv` (greedy, on held-out episodes),
`curve.png`, `best_agent.safetensors` (give it to `modpush.load_agent` or `modpush evaluate --policy`),
`checkpoints/`, and the files of TensorBoard in `logs/`. Ctrl-C, SIGTERM and SIGHUP write a checkpoint
and stop.

Presets:
  cpu                The configuration that learns soonest on two CPU cores, in ten to thirty minutes.
  any_object         The same with twelve objects, eight of them of random shape, and random mass and
                     friction.
  movable            The small cube among boxes that can be pushed away, past which there may be no
                     path.
  refine             Further training of a run of `cpu`, with higher weights for contact, collisions
                     and detours.
  refine_any_object  The same for a run of `any_object`.
  paper              The paper's configuration: 7e6 steps with one update each, which takes days on a
                     CPU.
  paper_cpu          The paper's observation, planner, replay, curriculum and penalties, and what it
                     takes to learn with them on two CPU cores, in an hour and a half.
  pose               Goals with orientation in free space, for a box of 10 x 5 cm, in some twenty
                     minutes of one core.
  pose_any_object    The same for eight shapes, whose mass, friction and centre of mass are drawn for
                     each episode.
  pose_obstacles     Goals with orientation past one or two obstacles that stand or move, for nine
                     objects.
  smoke              A run of a few seconds that does everything once and learns nothing.

The defaults of the options that begin with `--train.` are the preset's; those of `cpu` stand in
brackets. NAME may be "module:name", for a part of your own.

Run:
  --out FOLDER                        Folder of the run; by default runs/train_PRESET.
  --resume                            Continue the run in the folder from its newest checkpoint.
  --config FILE                       YAML file of settings that replace the preset's, such as another
                                      run's config.yaml; the options below replace the file's.
  --allow MODULE ...                  Modules from which this file may import its author's own parts.
  --init-from AGENT                   Start from the weights of a shipped agent, an agent's file, a
                                      run's folder or a checkpoint.
  --minutes X                         Training time after which the run ends like a completed one.
  --train.total-steps N               Environment steps after which the run ends [500000].
  --train.seed N                      Seed of everything that is drawn at random [0].
  --threads N                         Number of torch's threads in the learner's process [1].
  --collector {local,ray}             Where the scenes act: in a process of this machine, or on a Ray
                                      cluster [local].
  --num-collectors N                  Number of collectors on the Ray cluster [1].
  --train.evaluate-every N            Environment steps between evaluations on held-out episodes
                                      [25000].
  --train.loggers csv tensorboard     TorchRL loggers that are written to [csv].

Environment:
  --train.env.num-envs N              Number of scenes stepped together [16].
  --train.env.scenario.scene NAME ... Scene families, one of which is drawn for each episode.
  --train.env.scenario.pushed-object NAME ...
                                      Objects, one of which is drawn for each episode; random_7 has a
                                      random shape [small_cube].
  --train.env.scenario.randomize-dynamics
                                      Draw the object's mass, friction and centre of mass.
  --train.env.simulation.engine NAME  Physics engine: sapien, mujoco, or module:name [sapien].
  --train.env.simulation.robot NAME   Arm: ur5, ur10, ... or module:name [ur5].
  --train.env.simulation.tool NAME    Tool of the arm: 2f85 (the closed gripper), rod, or module:name
                                      [2f85].
  --train.env.planner NAME            distance_field, lazy_theta_star_grid, lazy_theta_star, a_star,
                                      straight_line or through_obstacles [distance_field].
  --train.env.inflation INFLATION     How far obstacles are inflated for planning: circumscribed,
                                      inscribed, widest, or a distance in metres [widest].
  --train.env.encoder NAME            Encoder of the local window: vae, rays, none, end_to_end (trained
                                      with the agent), or a file of a DepthVAE [vae].
  --train.env.frame {base,object,path}
                                      Axes of the observation and of the local window [path].
  --train.env.add NAME ...            Entries to add to the observation.
  --train.env.leave-out NAME ...      Entries to leave out of it.
  --reward-term NAME WEIGHT ...       Your own reward terms, with their weights.
  --train.env.reward.weights.TERM X   Weight of one of the preset's reward terms.

Learner (TQC) and replay buffer:
  --train.tqc.loss NAME               tqc, sac or td3 [tqc].
  --train.tqc.hidden-sizes N ...      Widths of the hidden layers of the actor and of each critic
                                      [256 256].
  --train.tqc.actor-lr X              Learning rate of the actor; also --train.tqc.critic-lr [0.0006].
  --train.tqc.gamma X                 Discount factor per step [0.98].
  --train.tqc.batch-size N            Number of transitions in each update, the same as the next [256].
  --train.replay.batch-size N         Number of transitions in each sample, the same as the last [256].
  --train.tqc.updates-per-step X      Number of updates per environment step [0.125].
  --train.tqc.learning-starts N       Environment steps before the first update [3000].
  --train.replay.sampler NAME         attentive, uniform or prioritized [attentive].
  --train.replay.n-steps N            Number of steps whose rewards are summed before bootstrapping [3].
  --train.replay.capacity N           Number of transitions that the buffer holds [1000000].
  --train.no-mirror                   Do not learn from mirror images.
  --train.curriculum.promotion {success,off}
                                      When the next stage of the curriculum begins [off].

Every other field of `TrainConfig` is an option in the same way, such as `--train.tqc.tau 0.01`.
docs/train_options.md lists all of them with their defaults, and the settings of each preset.
"""

import argparse
import sys
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, field, is_dataclass, replace
from pathlib import Path
from typing import Any, Literal

import pandas as pd
import tyro

from modpush._types import Count, FilePath
from modpush._validation import checked, from_plain
from modpush.cli.command import check_preset
from modpush.files import parse_yaml, reading
from modpush.parts import check_allowed
from modpush.training import TRAIN_PRESETS, TrainConfig, Trainer
from modpush.training.log import draw_curve
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
            draw_curve(folder.evaluations, folder.curve)
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


def parse_run(arguments: Sequence[str]) -> RunConfig:
    """The run of a command line: a preset, changed by the file of `--config`, changed by the options.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If there is no such preset, or the file does not fit.
    """
    check_preset(arguments)
    preset, *options = arguments
    # The file decides the defaults of all other options, so that it is read before these are parsed.
    parser = argparse.ArgumentParser(f"modpush train {preset}", add_help=False, allow_abbrev=False)
    parser.add_argument("--config", type=Path)
    parser.add_argument("--allow", nargs="+", default=[])
    given, options = parser.parse_known_args(options)
    words = [option.partition("=") for option in options]
    options = [
        SHORT_FORMS.get(word.replace("_", "-"), word) + is_ + value for word, is_, value in words
    ]
    config = TRAIN_PRESETS[preset]
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


def main(arguments: Sequence[str]) -> None:
    """`modpush train <arguments>`; says after an interrupt how to continue."""
    run = parse_run(arguments)
    try:
        train_agent(run)
    except KeyboardInterrupt:
        if RunFolder(run.out).checkpoints.latest() is None:
            print("\nStopped before the first checkpoint; start again with the same command.")
        else:
            print(f"\nStopped; a checkpoint is in {run.out}. Continue with --resume.")
        raise KeyboardInterrupt("") from None
