"""`collect_demonstrations`: runs policies and writes what they do as a data set."""

import json
import warnings
from collections.abc import Iterable, Iterator
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pandas as pd
from gymnasium.envs.registration import EnvSpec
from torchrl.envs import EnvBase, TransformedEnv
from tqdm import tqdm

import modpush.envs  # noqa: F401  # registers the environments
from modpush._arguments import checked_arguments
from modpush._extras import require_extra
from modpush._folder_lock import FolderLock
from modpush._threads import torch_threads
from modpush._types import Count
from modpush.data.card import card_text
from modpush.data.config import MAX_NUMBER, CollectConfig, episode_seed
from modpush.data.maniskill_file import write_maniskill
from modpush.data.minari_folder import write_minari
from modpush.data.recording_env import RecordingEnv
from modpush.data.store import DemonstrationStore
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


@checked_arguments
def collect_demonstrations(
    config: CollectConfig, progress: bool = True, *, threads: Count = 1
) -> Path:
    """Run policies from starts drawn for this purpose, and write their episodes and a card.

    The folder gets `README.md` (the card), `minari/` (a data set for Minari; point
    `MINARI_DATASETS_PATH` there), `trajectory.h5` and `trajectory.json` (ManiSkill's format), and
    `episodes/` with `attempts.csv`, from which a run that was interrupted, or that asks for more
    episodes, continues. The data sets hold the policies and the number of episodes of this call.

    Args:
        config: What to collect, and where to write it.
        progress: Show a progress bar.
        threads: Number of torch's threads meanwhile.

    Returns:
        The folder.

    Raises:
        MissingExtraError: If a package of the extra `data` is missing.
        FolderLockedError: If another process writes to the folder.
        ValueError: If a policy is unknown, two have the same name, the folder holds other demonstrations,
            or with `only_success` a policy solves too few episodes.
    """
    require_extra("collect_demonstrations", "h5py", *(["minari"] * ("minari" in config.formats)))
    methods = get_methods(config.policy, allow=config.allow)
    labels = [method.name for method in methods]
    spec, spaces = _gym_spec(config)
    with FolderLock(config.out), torch_threads(threads):
        env = make_push_env(config.env, keep_images=True)
        fingerprint = environment_fingerprint(env)
        recorder = RecordingEnv(env, images=config.images)
        try:
            store = DemonstrationStore(config.out, _about(config, fingerprint))
            if left_out := sorted(set(store.policies()) - set(labels)):
                warnings.warn(
                    f"collect_demonstrations: the data sets in {config.out} will hold only the "
                    f"policies {labels}; also name {left_out}, whose episodes it has, to include them.",
                    stacklevel=3,
                )
            chosen = [_collect(method, recorder, store, config, progress) for method in methods]
        finally:
            recorder.close()
        rows = pd.concat(chosen, ignore_index=True)
        about = {
            "env": asdict(config.env),
            "fingerprint": fingerprint,
            "policies": {label: store.policies()[label] for label in labels},
            "only_success": config.only_success,
        }
        if "minari" in config.formats:
            read = partial(store.read, rows)
            write_minari(config.out / "minari", config.dataset_id, read, spec, spaces, about)
        if "maniskill" in config.formats:
            write_maniskill(config.out / "trajectory.h5", store.read(rows), config.env)
        write_text(config.out / "README.md", card_text(config, rows, store.rows(), about))
    return config.out


def _gym_spec(config: CollectConfig) -> tuple[EnvSpec, tuple[gymnasium.Space, gymnasium.Space]]:
    """What the recorded environment is made again from, and its spaces; fails before any work is done."""
    made = gymnasium.make("modpush/Push-v0", **config.env_options())
    spaces = (made.observation_space, made.action_space)
    made.close()
    assert made.spec is not None
    return made.spec, spaces


def _about(config: CollectConfig, fingerprint: dict[str, Any]) -> dict[str, Any]:
    """What all episodes of a folder have in common."""
    env = asdict(replace(config.env, num_envs=1))
    return _plain(
        {
            "env": env,
            "fingerprint": fingerprint,
            "seed": config.seed,
            "only_success": config.only_success,
            "images": config.images,
        }
    )


def _plain(value: Any) -> Any:
    """The same after a round trip through JSON: tuples are lists."""
    return json.loads(json.dumps(value))


def _collect(
    method: Method,
    recorder: RecordingEnv,
    store: DemonstrationStore,
    config: CollectConfig,
    progress: bool,
) -> pd.DataFrame:
    """Run what is missing of one policy; returns the rows of the episodes to write, by number."""
    policy = method.make_policy()
    store.claim_policy(method.name, _plain(describe_policy(policy)))
    env: EnvBase | None = None
    with tqdm(desc=method.name, unit="episode", disable=not progress) as bar:
        bar.total = config.episodes
        while True:
            rows = store.rows()
            rows = rows[rows["policy"] == method.name]
            kept = rows[rows["kept"]]
            bar.n = min(len(kept), config.episodes)
            bar.refresh()
            tried = set(rows["number"])
            left = [n for n in range(max(tried, default=0)) if n not in tried]  # by a kill
            if len(kept) >= config.episodes and not left:
                return kept.head(config.episodes)
            if len(kept) < config.episodes:
                _check_tries(method.name, len(rows), len(kept), config)
            numbers = left or _next_numbers(len(tried), config.episodes - len(kept), config)
            if env is None:
                env = _with_policy_view(method, recorder, config.objects)
            for kept_one in _run(env, policy, recorder, store, config, method, numbers):
                bar.update(kept_one)


def _next_numbers(first: int, missing: int, config: CollectConfig) -> range:
    """Numbers of the starts to run next."""
    if config.only_success:  # some may fail; scenes that have nothing to do cost the same
        missing = max(missing, config.env.num_envs)
    return range(first, min(first + missing, MAX_NUMBER))


def _check_tries(name: str, tried: int, kept: int, config: CollectConfig) -> None:
    if tried >= min(_TRIES * config.episodes + 20, MAX_NUMBER):
        raise ValueError(
            f"collect_demonstrations: {name!r} reached the goal in {kept} of {tried} episodes, which "
            f"is too few to find {config.episodes}; ask for fewer, or easier scenes."
        )


def _with_policy_view(
    method: Method, recorder: RecordingEnv, objects: tuple[str, ...]
) -> TransformedEnv:
    """The recorder with the transforms of the environment that the policy was made for."""
    own = method.make_env(recorder.batch_size[0], objects)
    transform = own.transform.clone()
    own.close()
    return TransformedEnv(recorder, transform)


def _run(
    env: EnvBase,
    policy: Any,
    recorder: RecordingEnv,
    store: DemonstrationStore,
    config: CollectConfig,
    method: Method,
    numbers: Iterable[int],
) -> Iterator[bool]:
    """Run episodes and store them; yields of each whether it was kept."""
    rows: dict[int, int] = {}

    def note_row(row: int, number: int) -> None:
        rows[number] = row

    starts = ((number, _start(config, number)) for number in numbers)
    inflation = config.env.path_inflation
    for episode in run_episodes(env, policy, starts, inflation=inflation, on_step=note_row):
        number = episode.number
        seed = episode_seed(config.seed, number)
        found = recorder.demonstration(rows[number], policy=method.name, number=number, seed=seed)
        kept = found.success or not config.only_success
        store.write(found, episode.metrics, kept)
        yield kept


def _start(config: CollectConfig, number: int) -> Scenario:
    """The start that `reset(seed=...)` of the recorded environment draws."""
    generator = np.random.default_rng(episode_seed(config.seed, number))
    tool = config.env.simulation.tool
    return sample_scenario(generator, config.env.filled_scenario(), tool=tool)
