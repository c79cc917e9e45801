"""A scene family of your own: a wall with a gate that is not in the middle.

    python examples/extending/scene.py

Contract: a function `(rng, difficulty in [0, 1]) -> list[Obstacle]`, in the robot's base frame [m, rad].
"""

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from modpush import Trainer
from modpush.envs import Obstacle
from modpush.training import TRAIN_PRESETS


def gate(rng: np.random.Generator, difficulty: float) -> list[Obstacle]:
    """A wall across the workspace with one opening, 20 cm wide at difficulty 0 and 12 cm at 1."""
    width = 0.20 - 0.08 * difficulty
    middle = rng.uniform(-0.12, 0.12)
    walls = []
    for low, high in ((-0.35, middle - width / 2), (middle + width / 2, 0.35)):
        walls.append(Obstacle((high - low, 0.04, 0.05), (0.475, (low + high) / 2, np.pi / 2)))
    return walls


def main(folder: Path) -> list[str]:
    """Train a few steps in the scene; returns the families that the run was evaluated on."""
    config = TRAIN_PRESETS["smoke"]
    # A phase without scenes of its own draws the environment's, which is the gate here.
    phases = (replace(config.curriculum.phases[-1], scenes=()),)
    config = replace(config, curriculum=replace(config.curriculum, phases=phases))
    Trainer(config, folder, parts={"scene": gate}).run()
    columns = pd.read_csv(folder / "evaluations.csv").columns
    return [name.removeprefix("success/") for name in columns if name.startswith("success/")]


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        print(main(Path(folder) / "run"))
