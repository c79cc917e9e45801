"""A similarity of your own for attentive replay: states with the goal at a like distance.

    python examples/extending/similarity.py

Contract: a function `(candidates [Q, C, n], queries [Q, n]) -> [Q, C]`, larger for what is more alike.
"""

import tempfile
from pathlib import Path

import pandas as pd
from torch import Tensor

from modpush import Trainer
from modpush.training import TRAIN_PRESETS

GOAL_DISTANCE = 41
"""Column of `goal_distance` in the observation, see `PushObservation.columns`."""


def like_distance(candidates: Tensor, queries: Tensor) -> Tensor:
    """Negative difference of the distances to the goal, `[Q, C]`."""
    return -(candidates[..., GOAL_DISTANCE] - queries[:, None, GOAL_DISTANCE]).abs()


def main(folder: Path) -> float:
    """Train a few steps with it; returns the mean similarity of what was sampled."""
    Trainer(TRAIN_PRESETS["smoke"], folder, parts={"similarity": like_distance}).run()
    return float(pd.read_csv(folder / "log.csv")["learner/similarity"].mean())


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        print(main(Path(folder) / "run"))
