"""Demonstrations as a Minari data set."""

import importlib.metadata
import json
import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.envs.registration import EnvSpec

import modpush
from modpush.data.demonstration import Demonstration

__all__ = ["write_minari"]

_IMAGES = ("depth", "segmentation")


def write_minari(
    root: Path,
    dataset_id: str,
    read: Callable[[], Iterable[Demonstration]],
    spec: EnvSpec,
    spaces: tuple[gymnasium.Space, gymnasium.Space],
    about: Mapping[str, Any],
) -> Path:
    """Write a data set that `minari.load_dataset` finds where `MINARI_DATASETS_PATH` is `root`.

    Observations, actions and rewards are those of `spec`'s environment. `infos` has poses, flags and
    images at reset and after each step, and the `command` of each step. Each episode's metadata has
    its seed, `policy`, `scene`, `pushed_object`, `success` and `scenario` (JSON). The folder takes
    the place of an earlier one when all is written.

    Args:
        root: Folder of all data sets.
        dataset_id: Name of this one, `"namespace/name-v0"`.
        read: Reads the episodes, one after the other; called twice.
        spec: What the environment is made again from.
        spaces: Its observation and action space.
        about: What else is kept in the metadata, under `"modpush"`.

    Returns:
        The folder with the data.
    """
    from minari.dataset.minari_storage import MinariStorage

    folder = root.resolve() / dataset_id / "data"  # Minari joins a relative path to itself
    unfinished = folder.with_name(f".data.{os.getpid()}.tmp")
    for left in folder.parent.glob(".data.*.tmp"):
        shutil.rmtree(left)  # of a process that was killed: the run's folder is locked
    unfinished.mkdir(parents=True)
    storage = MinariStorage.new(unfinished, *spaces, env_spec=spec)
    metadata: list[dict[str, Any]] = []
    low, high = spaces[0].low, spaces[0].high  # type: ignore[attr-defined]  # a Box
    storage.update_episodes(_buffers(read(), metadata, low, high))
    _add_images(unfinished / "main_data.hdf5", read())
    storage.update_episode_metadata(metadata)
    storage.update_metadata(
        {
            "dataset_id": dataset_id,
            "minari_version": importlib.metadata.version("minari"),
            "author": {"modpush"},
            "algorithm_name": ", ".join(about["policies"]),
            "description": "Pushing an object through clutter to a goal, see the card.",
            "requirements": [f"modpush=={modpush.__version__}"],
            "modpush": dict(about),
        }
    )
    if folder.exists():
        shutil.rmtree(folder)
    unfinished.rename(folder)
    return folder


def _buffers(
    demonstrations: Iterable[Demonstration],
    metadata: list[dict[str, Any]],
    low: np.ndarray,
    high: np.ndarray,
) -> Iterator[Any]:
    """Minari's form of each episode; what Minari keeps of one beside it is appended to `metadata`."""
    from minari.data_collector.episode_buffer import EpisodeBuffer

    for number, found in enumerate(demonstrations):
        metadata.append(
            {
                "policy": found.policy,
                "number": found.number,
                "scene": found.scenario.scene,
                "pushed_object": found.scenario.pushed_object,
                "success": found.success,
                "scenario": json.dumps(found.scenario.to_dict()),
            }
        )
        yield EpisodeBuffer(
            id=number,
            seed=found.seed,
            observations=np.clip(found.observation, low, high),
            actions=found.action,
            rewards=list(found.reward),
            terminations=list(found.terminated),
            truncations=list(found.truncated),
            infos={**found.poses, **found.flags, "command": found.command},
        )


def _add_images(path: Path, demonstrations: Iterable[Demonstration]) -> None:
    """Add images to the infos, compressed, which Minari itself does not do."""
    import h5py

    with h5py.File(path, "a") as file:
        for number, found in enumerate(demonstrations):
            for name in _IMAGES:
                images = getattr(found, name)
                if images is not None:
                    file[f"episode_{number}/infos"].create_dataset(
                        name,
                        data=images,
                        chunks=(1, *images.shape[1:]),
                        compression="gzip",
                        shuffle=True,
                    )
