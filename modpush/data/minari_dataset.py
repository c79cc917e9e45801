"""`RecordedEpisode`, and the writer of a Minari data set of them."""

import json
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.envs.registration import EnvSpec
from numpy.typing import NDArray

import modpush
from modpush.envs.scenes.scenario import Scenario

_DATA = "data"
"""Name of Minari's folder of episodes in the folder of a data set."""


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


class DatasetWriter:
    """Writes a Minari data set beside its place `<root>/modpush/<name>`, which `finish` gives it.

    `spec` is that of the Gymnasium environment that `recover_environment` makes.
    """

    def __init__(self, folder: Path, spec: EnvSpec) -> None:
        self._folder, self._spec = folder, spec
        if (folder / _DATA).exists():
            raise FileExistsError(
                f"collect_demonstrations: {folder} holds a data set; choose another folder."
            )
        self._unfinished = folder / ".unfinished"
        self._storage: Any = None
        self.count = 0
        """Number of episodes so far."""

    def add(self, episodes: Sequence[RecordedEpisode]) -> None:
        """Write episodes."""
        if not episodes:
            return
        if self._storage is None:
            self._storage = self._begin()
        low, high = self._storage.observation_space.low, self._storage.observation_space.high
        self._storage.update_episodes([_buffer(episode, low, high) for episode in episodes])
        numbers = range(self.count, self.count + len(episodes))
        self._storage.update_episode_metadata([_metadata(e) for e in episodes], numbers)
        _add_images(self._unfinished / "main_data.hdf5", episodes, self.count)
        self.count += len(episodes)

    def finish(self, about: dict[str, Any]) -> None:
        """Put the data set in its place, with plain data under `"modpush"` of its metadata."""
        algorithms = ", ".join(about["policies"])
        self._storage.update_metadata({"algorithm_name": algorithms, "modpush": about})
        self._unfinished.rename(self._folder / _DATA)

    def _begin(self) -> Any:
        """Minari's storage of a data set without an episode."""
        from minari.dataset.minari_storage import MinariStorage

        shutil.rmtree(self._unfinished, ignore_errors=True)  # of a killed process
        self._unfinished.mkdir(parents=True)
        env = gymnasium.make(self._spec)
        spaces = env.observation_space, env.action_space
        env.close()
        storage = MinariStorage.new(self._unfinished.resolve(), *spaces, env_spec=self._spec)
        storage.update_metadata(
            {
                "dataset_id": f"{self._folder.parent.name}/{self._folder.name}",
                "minari_version": version("minari"),
                "author": {"modpush"},
                "description": "Pushing an object through clutter to a goal, see the card.",
                "requirements": [f"modpush=={modpush.__version__}"],
            }
        )
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
