"""An observation entry of your own: whether object and tool touch obstacles.

    python examples/extending/observation_entry.py

Contract: a function `ObservationInputs -> [..., n]` in SI units, or an `Entry` of one with the scale that
brings it to order 1. It may read any key of the environment.
"""

import tempfile
from pathlib import Path

import torch
from torch import Tensor

from modpush import Trainer, load_agent
from modpush.mdp import Entry, ObservationInputs
from modpush.training import TRAIN_PRESETS


def read_obstacle_contacts(inputs: ObservationInputs) -> Tensor:
    """1 where object and tool touch obstacles, `[..., 2]`, from two keys of `PushEnv`."""
    flags = (inputs["obstacle_contact"], inputs["tool_obstacle_contact"])
    return torch.cat(flags, -1).float()


obstacle_contacts = Entry(read_obstacle_contacts, scale=2.0)


def main(folder: Path) -> list[str]:
    """Train a few steps with the entry; returns the entries that the agent's file remembers."""
    parts = {"entries": ["latent", "ee_position", "goal", ("contacts", obstacle_contacts)]}
    Trainer(TRAIN_PRESETS["smoke"], folder, parts=parts).run()
    agent = load_agent(folder / "last_agent.safetensors", parts=parts)
    agent.make_env(num_envs=1).close()  # compares the entries with those that it was trained on
    return [entry["name"] for entry in agent.fingerprint["observation"]["entries"]]


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        print(main(Path(folder) / "run"))
