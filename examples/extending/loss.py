"""A loss of your own: TorchRL's SAC with the same actor and two scalar critics.

    python examples/extending/loss.py

Contract: a function `(TQCConfig, actor, critics, LearnerSpecs) -> LossModule` of TorchRL, with its value
estimator set. What it returns under names that begin with `loss_` is minimised.
"""

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
from torchrl.objectives import SACLoss

from modpush import Trainer
from modpush.agents import LearnerSpecs, TQCConfig
from modpush.training import TRAIN_PRESETS


def sac(config: TQCConfig, actor: Any, critics: list[Any], specs: LearnerSpecs) -> SACLoss:
    """Soft actor-critic."""
    loss = SACLoss(
        actor,
        critics,
        num_qvalue_nets=len(critics),
        alpha_init=config.alpha_init,
        action_spec=specs.action,
    )
    loss.make_value_estimator(gamma=config.gamma)
    return loss


def main(folder: Path) -> int:
    """Train a few steps with it; returns the number of updates."""
    config = TRAIN_PRESETS["smoke"]
    scalar = replace(config.tqc, num_quantiles=1, top_quantiles_to_drop_per_net=0)
    Trainer(replace(config, tqc=scalar), folder, parts={"loss": sac}).run()
    return int(pd.read_csv(folder / "log.csv")["updates"].iloc[-1])


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        print(main(Path(folder) / "run"))
