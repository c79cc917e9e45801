"""`collect_demonstrations`: runs policies and writes their episodes as a Minari data set."""

import json
from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from torchrl.envs import EnvBase, TransformedEnv
from tqdm import tqdm

import modpush.envs  # noqa: F401  # registers the environments
from modpush._arguments import checked_arguments
from modpush._atomic import FolderLock
from modpush._extras import require_extra
from modpush._processes import torch_threads
from modpush._types import Count
from modpush.data.config import MAX_NUMBER, CollectConfig, card_text, episode_seed
from modpush.data.minari_dataset import RecordedEpisode, extend_dataset, read_about
from modpush.data.recording_env import RecordingEnv
from modpush.envs.scenes.sampling import sample_scenario
from modpush.envs.scenes.scenario import Scenario
from modpush.evaluation.episodes import run_episodes
from modpush.evaluation.results import describe_policy
from modpush.files import write_text
from modpush.recipes.fingerprint import environment_fingerprint
from modpush.recipes.make_env import make_push_env
from modpush.recipes.methods import Method, get_methods

__all__ = ["collect_demonstrations"]

_TRIES = 10
"""With `only_success`, the largest number of episodes to run for each that is to be kept."""
_BATCH = 200
"""Number of episodes after which they are written; a kill loses at most these."""
_BATCH_WITH_IMAGES = 20


@checked_arguments
def collect_demonstrations(
    config: CollectConfig, progress: bool = True, *, threads: Count = 1
) -> Path:
    """Run policies from starts drawn for this purpose, and write their episodes and a card.

    The folder gets `README.md` (the card) and `minari/`, the root of a data set for Minari. A data set
    that is there already, of the same environment and seed, is extended: by episodes that are missing
    after an interrupt, by more episodes, or by further policies.

    Args:
        config: Policies, environment and number of episodes, and the folder.
        progress: Show a progress bar.
        threads: Number of torch's threads.

    Returns:
        The folder.

    Raises:
        MissingExtraError: If a package of the extra `data` is missing.
        FolderLockedError: If another process writes to the folder.
        ValueError: If a policy is unknown, the folder holds other demonstrations or those of another
            policy of the same name, or with `only_success` a policy solves too few episodes.
    """
    require_extra("collect_demonstrations", "minari")
    methods = get_methods(config.policy, allow=config.allow)
    made = gymnasium.make("modpush/Push-v0", **config.env_options())
    spec = made.spec
    made.close()
    assert spec is not None
    folder = config.out / "minari" / config.dataset_id
    with FolderLock(config.out), torch_threads(threads):
        env = make_push_env(config.env, keep_images=True)
        recorder = RecordingEnv(env, images=config.images)
        try:
            about = _about(config, environment_fingerprint(env), read_about(folder))
            policies = {method.name: method.make_policy() for method in methods}
            for name, policy in policies.items():
                _claim(name, policy, about["policies"], folder)

            def write(episodes: list[RecordedEpisode]) -> None:
                if episodes:
                    extend_dataset(folder, episodes, spec, about)
                    write_text(config.out / "README.md", card_text(config, about))

            for method in methods:
                counts = about["policies"][method.name]
                runner = _Runner(method, policies[method.name], recorder, config, counts)
                runner.collect(write, progress)
        finally:
            recorder.close()
    return config.out


def _about(
    config: CollectConfig, fingerprint: dict[str, Any], found: dict[str, Any] | None
) -> dict[str, Any]:
    """The metadata of the data set, from before if there is one.

    Raises:
        ValueError: If that data set was collected otherwise.
    """
    asked = {
        "env": asdict(replace(config.env, num_envs=1)),
        "fingerprint": fingerprint,
        "seed": config.seed,
        "only_success": config.only_success,
        "images": config.images,
    }
    asked = json.loads(json.dumps(asked))  # tuples are lists in what is read
    if found is None:
        return {**asked, "policies": {}}
    if other := {
        key: (found.get(key), asked[key]) for key in asked if found.get(key) != asked[key]
    }:
        raise ValueError(
            f"collect_demonstrations: {config.out} holds other demonstrations, (there, asked for): "
            f"{other}. Choose another folder."
        )
    return found


def _claim(name: str, policy: Any, policies: dict[str, Any], folder: Path) -> None:
    """Note the policy of a name, with its counts of episodes, or compare it with the one noted."""
    described = json.loads(json.dumps(describe_policy(policy)))
    found = policies.setdefault(
        name, {"described": described, "tried": 0, "solved": 0, "kept": 0, "steps": 0}
    )
    if found["described"] != described:
        raise ValueError(
            f"collect_demonstrations: {folder} holds episodes of another policy {name!r}, "
            f"{found['described']}, got {described}. Choose another folder."
        )


class _Runner:
    """Runs the missing episodes of one policy.

    Args:
        method: The policy's name, and the environment that it was made for.
        policy: The policy.
        recorder: The environment that records.
        config: Settings of the data set.
        counts: Numbers of episodes `tried`, `solved` and `kept`, and of `steps` kept; kept up to date.
    """

    def __init__(
        self,
        method: Method,
        policy: Any,
        recorder: RecordingEnv,
        config: CollectConfig,
        counts: dict[str, int],
    ) -> None:
        self._method, self._policy, self._recorder = method, policy, recorder
        self._config, self._counts = config, counts

    def collect(self, write: Callable[[list[RecordedEpisode]], None], progress: bool) -> None:
        """Run episodes until enough are kept; `write` gets them in batches, and at an interrupt."""
        config, counts = self._config, self._counts
        batch = _BATCH_WITH_IMAGES if config.images else _BATCH
        env = self._env() if counts["kept"] < config.episodes else None
        with tqdm(
            desc=self._method.name,
            unit="episode",
            total=config.episodes,
            initial=min(counts["kept"], config.episodes),
            disable=not progress,
        ) as bar:
            while counts["kept"] < config.episodes:
                self._check_tries()
                missing = config.episodes - counts["kept"]
                if config.only_success:  # some may fail; idle scenes cost as much as busy ones
                    missing = max(missing, config.env.num_envs)
                first = counts["tried"]
                numbers = range(first, min(first + min(missing, batch), MAX_NUMBER))
                found: dict[int, RecordedEpisode] = {}
                try:
                    for episode in self._run(env, numbers):
                        found[episode.number] = episode
                        bar.update(episode.success or not config.only_success)
                finally:  # after an interrupt, those before the first that is missing
                    write(self._keep(found, first))

    def _keep(self, found: dict[int, RecordedEpisode], first: int) -> list[RecordedEpisode]:
        """The episodes to write in the order of their numbers, counted."""
        kept: list[RecordedEpisode] = []
        for number in range(first, MAX_NUMBER):
            if (episode := found.get(number)) is None:
                return kept
            self._counts["tried"] += 1
            self._counts["solved"] += episode.success
            if episode.success or not self._config.only_success:
                self._counts["kept"] += 1
                self._counts["steps"] += len(episode.action)
                kept.append(episode)
        return kept

    def _check_tries(self) -> None:
        tried, solved, asked = self._counts["tried"], self._counts["solved"], self._config.episodes
        if tried >= min(_TRIES * asked + 20, MAX_NUMBER):
            raise ValueError(
                f"collect_demonstrations: {self._method.name!r} reached the goal in {solved} of {tried} "
                f"episodes, which is too few to find {asked}; ask for fewer, or easier scenes."
            )

    def _env(self) -> EnvBase:
        """The recorder with the transforms of the environment that the policy was made for."""
        own = self._method.make_env(self._recorder.batch_size[0], self._config.objects)
        transform = own.transform.clone()
        own.close()
        return TransformedEnv(self._recorder, transform)

    def _run(self, env: EnvBase | None, numbers: range) -> Iterator[RecordedEpisode]:
        assert env is not None
        rows: dict[int, int] = {}

        def note_row(row: int, number: int) -> None:
            rows[number] = row

        starts = ((number, _start(self._config, number)) for number in numbers)
        for episode in run_episodes(env, self._policy, starts, on_step=note_row):
            yield self._recorder.episode(
                rows[episode.number],
                policy=self._method.name,
                number=episode.number,
                seed=episode_seed(self._config.seed, episode.number),
            )


def _start(config: CollectConfig, number: int) -> Scenario:
    """The start that `reset(seed=...)` of the recorded environment draws."""
    generator = np.random.default_rng(episode_seed(config.seed, number))
    simulation = config.env.simulation
    return sample_scenario(
        generator,
        config.env.filled_scenario(),
        tool=simulation.tool,
        robot=simulation.robot,
        goal=simulation.goal,
    )
