"""Every kind of file that the library writes, and ways to damage it. Shared with the benchmarks."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import torch

from modpush.agents.tqc.networks import make_actor
from modpush.encoders import DepthVAE, WindowData
from modpush.evaluation.episodes import Trajectory
from modpush.evaluation.results import ResultStore
from modpush.evaluation.sets import load_set
from modpush.recipes import PushEnvConfig, load_agent, save_agent
from modpush.training import TRAIN_PRESETS
from modpush.training.run_folder import RunFolder

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


def _windows(folder: Path) -> tuple[Path, Reader]:
    path = folder / "windows.safetensors"
    flags = torch.zeros(4, dtype=torch.uint8)
    WindowData.from_floats(torch.rand(4, 1, 16, 16), flags, flags.bool(), {"seed": 3}).save(path)
    return path, lambda: WindowData.load(path)


def _set(folder: Path) -> tuple[Path, Reader]:
    path = folder / "set.json.gz"
    load_set("smoke").save(path)
    return path, lambda: load_set(path)


def _config(folder: Path) -> tuple[Path, Reader]:
    run = RunFolder(folder)
    run.write_config(TRAIN_PRESETS["smoke"][1])
    return run.config, run.read_config


def _results(folder: Path) -> tuple[Path, Reader]:
    free = load_set("smoke")
    ResultStore(folder, free, {"class": "made"})
    return folder / "run.json", lambda: ResultStore(folder, free, {"class": "made"})


def _trajectory(folder: Path) -> tuple[Path, Reader]:
    path = folder / "trajectory.npz"
    rng = np.random.default_rng(0)
    poses = rng.random((9, 3)).astype(np.float32)
    Trajectory(
        object_pose=poses,
        ee_pose=poses,
        contacts=poses[1:] > 0.5,
        planned_path=poses[:, :2],
        target=poses[1:, :2],
    ).save(path)
    return path, lambda: Trajectory.load(path)


KINDS: dict[str, Callable[[Path], tuple[Path, Reader]]] = {
    "agent": _agent,
    "VAE weights": _vae,
    "windows": _windows,
    "evaluation set": _set,
    "config.yaml": _config,
    "run.json": _results,
    "trajectory": _trajectory,
}
"""Writes a file of a kind into a folder; returns its path and what reads it."""


def damages(content: bytes, flips: int, cuts: int, seed: int = 0) -> Iterator[bytes]:
    """A file's content with single bits flipped, and cut short, at random places."""
    rng = np.random.default_rng(seed)
    for bit in rng.choice(8 * len(content), min(flips, 8 * len(content)), replace=False).tolist():
        changed = bytearray(content)
        changed[bit // 8] ^= 1 << bit % 8
        yield bytes(changed)
    for length in rng.choice(len(content), min(cuts, len(content)), replace=False).tolist():
        yield content[:length]


def noticed(path: Path, read: Reader, flips: int = 200, cuts: int = 100) -> tuple[int, int]:
    """How many damaged versions of a file its reader refuses with a `ValueError` that names it.

    Returns:
        How many were refused, and of how many.
    """
    whole = path.read_bytes()
    read()
    refused = total = 0
    for content in damages(whole, flips, cuts):
        path.write_bytes(content)
        total += 1
        try:
            read()
        except ValueError as error:
            refused += path.name in str(error)
    path.write_bytes(whole)
    read()
    return refused, total
