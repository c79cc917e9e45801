"""Train an agent from Python: change what the preset says, train, and push with the result.

    python examples/train.py                    # 15 to 30 minutes on two CPU cores
    python examples/train.py --preset smoke     # everything once, in some seconds; learns nothing

The folder gets the config, logs, evaluations on held-out episodes, checkpoints and the best agent.
`modpush train` does the same from the command line, with every field of the config as an option, and
ends a run with a checkpoint on Ctrl-C.
"""

import os

# One thread for the learner; the other core is the environment's. Before torch is imported.
os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import warnings
from dataclasses import replace
from pathlib import Path

import modpush
from modpush.training import TRAIN_PRESETS, TrainConfig, Trainer
from modpush.training.log import draw_curve


def make_config(preset: str, seed: int) -> TrainConfig:
    """A preset with one thing changed: the encoder that sees the obstacles."""
    config = TRAIN_PRESETS[preset]
    return replace(config, seed=seed, env=replace(config.env, encoder="rays"))


def push(agent_file: Path, num_envs: int = 4) -> float:
    """Share of episodes that a trained agent solves, greedily."""
    agent = modpush.load_agent(agent_file)
    env = agent.make_env(num_envs, seed=0)
    rollout = env.rollout(200, agent.policy, break_when_any_done=False)
    env.close()
    return float(rollout["next", "success"].any(1).float().mean())


def main(preset: str, seed: int, out: Path) -> None:
    """Train, or continue the run in the folder."""
    trainer = Trainer(make_config(preset, seed), out, resume=(out / "checkpoints").exists())
    best = trainer.run()
    draw_curve(trainer.folder.evaluations, trainer.folder.curve)
    print(f"Best on the held-out episodes: {best}")
    print(f"It solves {push(trainer.folder.best_agent):.2f} of 4 new episodes.")


if __name__ == "__main__":  # the environment's process imports this file, too
    warnings.filterwarnings("ignore", message="Failed to find system libvulkan")
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--preset", default="cpu", choices=TRAIN_PRESETS, help="where to start")
    parser.add_argument("--seed", type=int, default=0, help="seed of all that is drawn")
    parser.add_argument("--out", type=Path, default=Path("runs/rays"), help="folder of the run")
    given = parser.parse_args()
    main(given.preset, given.seed, given.out)
