"""Demonstrations of two policies, collected once."""

from dataclasses import replace
from pathlib import Path

import pytest

from modpush.data import CollectConfig, collect_demonstrations
from modpush.recipes import PushEnvConfig

ENV = PushEnvConfig.preset(
    "cpu", num_envs=2, encoder="rays", scene=("free", "posts"), difficulty=(0.0, 0.3)
)
CONFIG = CollectConfig(policy=("scripted", "corridor"), episodes=3, env=ENV, images=True)


@pytest.fixture(scope="session")
def collected(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with three episodes of each of two policies, with images."""
    folder = tmp_path_factory.mktemp("demonstrations")
    return collect_demonstrations(replace(CONFIG, out=folder), progress=False)
