"""An encoder of your own: mean heights on a coarse grid over the local window.

    python examples/extending/encoder.py

Contract: a module that maps `window [B, 1, S, S]` float32 in [0, 1] to a latent `[B, latent_dim]`, and
has an attribute `latent_dim`; `window_size` says S where that is not 64.
"""

import tempfile
from pathlib import Path

import torch
from torch import Tensor, nn

from modpush import Trainer, load_agent
from modpush.training import TRAIN_PRESETS


class CoarseHeights(nn.Module):
    """Mean height in each cell of an `n x n` grid over the window, `[B, n * n]`.

    Args:
        n: Number of cells along each side.
    """

    window_size = 32

    def __init__(self, n: int = 4) -> None:
        super().__init__()
        self.n = n
        self.latent_dim = n * n

    def forward(self, window: Tensor) -> Tensor:
        """Encode `[B, 1, 32, 32]` windows to `[B, n * n]`."""
        return nn.functional.adaptive_avg_pool2d(window, self.n).flatten(1)


def main(folder: Path) -> dict[str, int]:
    """Train a few steps with the encoder, and load the trained agent with it."""
    config = TRAIN_PRESETS["smoke"]
    parts = {"encoder": CoarseHeights(4)}
    Trainer(config, folder, parts=parts).run()
    agent = load_agent(folder / "last_agent.safetensors", parts=parts)
    env = agent.make_env(num_envs=2, seed=0)
    with torch.no_grad():
        rollout = env.rollout(5, agent.policy, break_when_any_done=False)
    env.close()
    return {"latent": rollout["latent"].shape[-1], "updates": agent.metadata["updates"]}


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        print(main(Path(folder) / "run"))
