"""The Minari data set of a run: started, extended, and replaced only by a whole one."""

import json
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.envs.registration import EnvSpec
from numpy.typing import NDArray

import modpush
from modpush.envs.scenes.scenario import Scenario

__all__ = ["RecordedEpisode", "extend_dataset", "read_about"]

_DATA = "data"
"""Name of Minari's folder of episodes in the folder of a data set."""
_METADATA = "metadata.json"
_REPLACED = ".replaced"


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordedEpisode:
    """An episode of T control steps, in the axes of the recorded environment."""

    policy: str
    """Name of the policy that acted."""
    number: int
    """Number of its start among those of the data set."""
    seed: int
    """Seed of the start: `env.reset(seed=...)` begins the same episode."""
    scenario: Scenario
    """The start."""
    observation: NDArray[np.float32]
    """Observation at reset and after each step, `[T + 1, n]`."""
    action: NDArray[np.float32]
    """Action of each step, `[T, 3]` in [-1, 1]."""
    reward: NDArray[np.float32]
    """Reward of each step, `[T]`."""
    terminated: NDArray[np.bool_]
    """True where a step reached a terminal state, `[T]`."""
    truncated: NDArray[np.bool_]
    """True where a step cut the episode off, `[T]`."""
    infos: dict[str, NDArray[Any]]
    """Poses and flags at reset and after each step, `[T + 1, ...]`, and `command`, the action in the
    base frame, `[T, 3]`."""
    images: dict[str, NDArray[Any]]
    """`depth` [m] and `segmentation` at reset and after each step, `[T + 1, 256, 256]`; or nothing."""

    @property
    def success(self) -> bool:
        """True if the object reached the goal."""
        return bool(self.infos["success"][-1])


def read_about(folder: Path) -> dict[str, Any] | None:
    """Metadata that `extend_dataset` wrote beside the episodes; None without a data set.

    Args:
        folder: Folder of the data set, `<root>/modpush/<name>`.

    Raises:
        ValueError: If there is a data set of another program.
    """
    data, replaced = folder / _DATA, folder / _REPLACED
    if replaced.exists():  # by a process that was killed while it put a new data set in its place
        if data.exists():
            shutil.rmtree(replaced)
        else:
            replaced.rename(data)
    path = data / _METADATA
    if not path.exists():
        return None
    metadata = json.loads(path.read_text(encoding="utf-8"))
    # Without its spaces, Minari would make the environment, and import what its specification names.
    if not {"modpush", "observation_space", "action_space"} <= set(metadata):
        raise ValueError(f"collect_demonstrations: {folder} holds a data set of another program.")
    about: dict[str, Any] = metadata["modpush"]
    return about


def extend_dataset(
    folder: Path,
    episodes: Sequence[RecordedEpisode],
    spec: EnvSpec,
    about: dict[str, Any],
) -> None:
    """Add episodes to a data set, or begin one.

    They are added to a copy, which takes the data set's place when it is whole. After a kill the data set
    is as it was before or after the call.

    Args:
        folder: Folder of the data set, `<root>/modpush/<name>`.
        episodes: The episodes to add.
        spec: Specification of the Gymnasium environment that `recover_environment` makes.
        about: Plain data for the metadata, under `"modpush"`; takes the place of what was there.
    """
    data, unfinished, replaced = (folder / name for name in (_DATA, ".unfinished", _REPLACED))
    shutil.rmtree(unfinished, ignore_errors=True)
    if data.exists():
        shutil.copytree(data, unfinished)
    storage = _storage(unfinished, folder, spec)
    first = storage.total_episodes
    low, high = storage.observation_space.low, storage.observation_space.high
    storage.update_episodes([_buffer(episode, low, high) for episode in episodes])
    storage.update_episode_metadata(
        [_metadata(episode) for episode in episodes],
        range(first, first + len(episodes)),
    )
    _add_images(unfinished / "main_data.hdf5", episodes, first)
    storage.update_metadata({"algorithm_name": ", ".join(about["policies"]), "modpush": about})
    if data.exists():
        data.rename(replaced)
    unfinished.rename(data)
    shutil.rmtree(replaced, ignore_errors=True)


def _storage(unfinished: Path, folder: Path, spec: EnvSpec) -> Any:
    """Minari's storage in a folder that may not be there yet."""
    import gymnasium
    from minari.dataset.minari_storage import MinariStorage

    if unfinished.exists():
        return MinariStorage.read(unfinished.resolve())
    env = gymnasium.make(spec)
    spaces = (env.observation_space, env.action_space)
    env.close()
    unfinished.mkdir(parents=True)
    storage = MinariStorage.new(unfinished.resolve(), *spaces, env_spec=spec)
    metadata = {
        "dataset_id": f"{folder.parent.name}/{folder.name}",
        "minari_version": version("minari"),
        "author": {"modpush"},
        "description": "Pushing an object through clutter to a goal, see the card.",
        "requirements": [f"modpush=={modpush.__version__}"],
    }
    storage.update_metadata(metadata)
    return storage


def _buffer(episode: RecordedEpisode, low: NDArray[Any], high: NDArray[Any]) -> Any:
    """Minari's form of an episode, with observations in the bounds of their space."""
    from minari.data_collector.episode_buffer import EpisodeBuffer

    return EpisodeBuffer(
        seed=episode.seed,
        observations=np.clip(episode.observation, low, high),
        actions=episode.action,
        rewards=list(episode.reward),
        terminations=list(episode.terminated),
        truncations=list(episode.truncated),
        infos=episode.infos,
    )


def _metadata(episode: RecordedEpisode) -> dict[str, Any]:
    return {
        "policy": episode.policy,
        "number": episode.number,
        "scene": episode.scenario.scene,
        "pushed_object": episode.scenario.pushed_object,
        "success": episode.success,
        "scenario": json.dumps(episode.scenario.to_dict()),
    }


def _add_images(path: Path, episodes: Sequence[RecordedEpisode], first: int) -> None:
    """Add images to the infos, compressed, which Minari itself does not do."""
    import h5py

    with h5py.File(path, "a") as file:
        for number, episode in enumerate(episodes, first):
            for name, images in episode.images.items():
                file[f"episode_{number}/infos"].create_dataset(
                    name,
                    data=images,
                    chunks=(1, *images.shape[1:]),
                    compression="gzip",
                    shuffle=True,
                )
