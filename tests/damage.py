"""The kinds of files on which a policy acts, and ways to damage them. Shared with the tests of runs."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from modpush.agents.tqc.networks import make_actor
from modpush.encoders import DepthVAE
from modpush.recipes import PushEnvConfig, load_agent, save_agent

Reader = Callable[[], object]


def _agent(folder: Path) -> tuple[Path, Reader]:
    path = folder / "agent.safetensors"
    config = PushEnvConfig.preset("cpu", encoder="rays")
    spec = load_agent("small_cube").actor.spec["action"]
    actor = make_actor(55, spec, (8,))
    save_agent(path, actor, config, hidden_sizes=(8,), observation_dim=55, fingerprint={})
    return path, lambda: load_agent(path)


def _vae(folder: Path) -> tuple[Path, Reader]:
    path = folder / "vae.safetensors"
    DepthVAE(2, (2, 3, 4, 5), (5, 4, 3, 2)).save(path)
    return path, lambda: DepthVAE.from_pretrained(path)


KINDS: dict[str, Callable[[Path], tuple[Path, Reader]]] = {
    "agent": _agent,
    "VAE weights": _vae,
}
"""Writes a file of a kind into a folder; returns its path and a function that reads it."""


def damages(content: bytes, flips: int, cuts: int, seed: int = 0) -> Iterator[bytes]:
    """A file's content with single bits flipped, and cut short, at random places."""
    rng = np.random.default_rng(seed)
    for bit in rng.choice(8 * len(content), min(flips, 8 * len(content)), replace=False).tolist():
        changed = bytearray(content)
        changed[bit // 8] ^= 1 << bit % 8
        yield bytes(changed)
    for length in rng.choice(len(content), min(cuts, len(content)), replace=False).tolist():
        yield content[:length]
