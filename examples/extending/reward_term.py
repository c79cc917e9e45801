"""A reward term of your own: a penalty for large actions.

    python examples/extending/reward_term.py

Contract: a function `StepOutcome -> [..., 1]`, which may read the action and any key before and after the
step, and a weight in `RewardConfig.weights` under its name.
"""

import tempfile
from dataclasses import replace
from pathlib import Path

import pandas as pd
from torch import Tensor

from modpush import Trainer
from modpush.mdp import StepOutcome
from modpush.training import TRAIN_PRESETS


def large_actions(outcome: StepOutcome) -> Tensor:
    """The squared length of the action, negative, `[..., 1]`."""
    return -outcome["action"].square().sum(-1, keepdim=True)


def main(folder: Path) -> float:
    """Train a few steps with the term; returns the mean return of the training episodes."""
    config = TRAIN_PRESETS["smoke"]
    weights = {**config.env.reward.weights, "large_actions": 0.2}
    reward = replace(config.env.reward, weights=weights)
    config = replace(config, env=replace(config.env, reward=reward))
    Trainer(config, folder, parts={"reward_terms": {"large_actions": large_actions}}).run()
    return float(pd.read_csv(folder / "log.csv")["noisy/return"].mean())


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        print(main(Path(folder) / "run"))
