"""A short run, trained once for all tests of a process."""

from dataclasses import replace
from pathlib import Path

import pytest

from modpush.training import TRAIN_PRESETS, Trainer

SMOKE = replace(TRAIN_PRESETS["smoke"], total_steps=192, evaluate_every=96, checkpoint_every=64)
"""Two evaluations, three checkpoints and ten updates, one each 12 steps from step 64 on."""
SHORT = replace(SMOKE, total_steps=96)
"""Its first half: one evaluation and two updates."""


@pytest.fixture(scope="session")
def unbroken(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a run that nothing interrupted."""
    folder = tmp_path_factory.mktemp("unbroken") / "run"
    Trainer(SMOKE, folder).run()
    return folder
