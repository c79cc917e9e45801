"""`collect_demonstrations`: runs policies and writes their episodes as a Minari data set, with a card."""

import json
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import asdict, field, replace
from pathlib import Path
from typing import Annotated, Any

import gymnasium
import numpy as np
from annotated_types import Le
from pydantic import StringConstraints
from torchrl.envs import EnvBase, TransformedEnv
from tqdm import tqdm

import modpush
from modpush._atomic import FolderLock
from modpush._extras import require_extra
from modpush._processes import torch_threads
from modpush._types import AtLeastOne, Count, FilePath, Name, NonNegativeInteger, Several
from modpush._validation import checked, checked_arguments
from modpush.data.minari_dataset import DatasetWriter, RecordedEpisode
from modpush.data.recording_env import RecordingEnv
from modpush.envs.scenes.sampling import sample_scenario
from modpush.envs.scenes.scenario import Scenario
from modpush.evaluation.episodes import run_episodes
from modpush.evaluation.results import describe_policy
from modpush.files import dump_yaml, write_text
from modpush.recipes.config import END_TO_END, PushEnvConfig
from modpush.recipes.fingerprint import environment_fingerprint
from modpush.recipes.make_env import make_push_env
from modpush.recipes.methods import Method, get_methods

MAX_NUMBER = 1_000_000
"""Number of starts that there are for one seed."""
_FIRST_SEED = 1_000_000_000


def episode_seed(seed: int, number: int) -> int:
    """Seed of the start with a number below `MAX_NUMBER`, between 1e9 and 2^32.

    The evaluation sets and the episodes held out in training are drawn with smaller first words, so that
    none of their starts is among the demonstrations.
    """
    return _FIRST_SEED + MAX_NUMBER * seed + number


@checked
class CollectConfig:
    """Settings of `collect_demonstrations`, as the options of `modpush collect --help` explain them."""

    policy: AtLeastOne[Name] = ("agent",)
    episodes: Annotated[Count, Le(MAX_NUMBER)] = 100
    only_success: bool = False
    images: bool = False
    env: PushEnvConfig = field(default_factory=lambda: PushEnvConfig.preset("cpu", num_envs=8))
    """Environment whose observations, actions and rewards are recorded. Policies made for another
    environment observe their own; their actions are turned into the axes of this one."""
    seed: Annotated[NonNegativeInteger, Le(3000)] = 0
    name: Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9_]+$")] = "push"
    licence: Name = "MIT"
    allow: Several[Name] = ()
    out: FilePath = Path("runs/demonstrations")

    def __post_init__(self) -> None:
        """Refuse what a flat observation cannot hold, and policies that are named twice."""
        if self.env.encoder == END_TO_END:
            raise ValueError(
                f"CollectConfig: env.encoder={END_TO_END!r} has no flat observation; collect with "
                "images=True and another encoder, and encode the images when learning."
            )
        if len(set(self.policy)) < len(self.policy):
            raise ValueError(f"CollectConfig: a policy is named twice, got {self.policy}.")

    @property
    def objects(self) -> tuple[str, ...]:
        """Names of the objects that are pushed."""
        return self.env.scenario.pushed_object

    @property
    def dataset_id(self) -> str:
        """Minari's name of the data set."""
        return f"modpush/{self.name}-v0"

    def env_options(self) -> dict[str, Any]:
        """Arguments of `gymnasium.make("modpush/Push-v0", ...)`, as plain data.

        All fields are spelled out, so that they stay what they are when a preset changes.
        """
        return {"config": asdict(replace(self.env, num_envs=1))}


_CARD = """---
license: {licence}
tags: [robotics, pushing, demonstrations, modpush]
---
# Demonstrations `{name}`

An arm pushes an object through clutter to a goal, 15 steps per second; recorded with modpush {version}.
The starts are drawn from the seeds {first_seed} + number of the episode, the same for all policies; none
is in an evaluation set.

```yaml
{settings}```

`minari/{name}` holds observations, actions and rewards of `modpush/Push-v0`:

```python
from modpush.data import load_demonstrations

demonstrations = load_demonstrations("this folder")
print(demonstrations.transitions)
env = demonstrations.make_env(num_envs=8)
```
"""


def card_text(config: CollectConfig, about: Mapping[str, Any]) -> str:
    """The card as Markdown; `about` is the data set's metadata."""
    shown = {name: about[name] for name in ("policies", "only_success", "images", "env")}
    return _CARD.format(
        licence=config.licence,
        name=config.dataset_id,
        version=modpush.__version__,
        first_seed=episode_seed(config.seed, 0),
        settings=dump_yaml(shown),
    )


_TRIES = 10
"""With `only_success`, the largest number of episodes to run for each that is to be kept."""
_BATCH, _BATCH_WITH_IMAGES = 200, 20
"""Number of episodes in memory before they are written."""


@checked_arguments
def collect_demonstrations(
    config: CollectConfig, progress: bool = True, *, threads: Count = 1
) -> Path:
    """Run policies from starts drawn for this purpose, and write their episodes and a card.

    The folder gets `README.md` (the card) and `minari/`, the root of a data set for Minari. After an
    interrupt or an error the data set holds the episodes until then.

    Args:
        config: Policies, environment and number of episodes, and the folder.
        progress: Show a progress bar.
        threads: Number of torch's threads.

    Returns:
        The folder.

    Raises:
        MissingExtraError: If a package of the extra `data` is missing.
        FileExistsError: If the folder holds a data set of this name.
        FolderLockedError: If another process writes to the folder.
        ValueError: If a policy is unknown, or with `only_success` a policy solves too few episodes.
    """
    require_extra("collect_demonstrations", "minari")
    methods = get_methods(config.policy, allow=config.allow)
    made = gymnasium.make("modpush/Push-v0", **config.env_options())
    spec = made.spec
    made.close()
    assert spec is not None
    with FolderLock(config.out), torch_threads(threads), ExitStack() as stack:
        writer = DatasetWriter(config.out / "minari" / config.dataset_id, spec)
        env = make_push_env(config.env, keep_images=True)
        recorder = RecordingEnv(env, images=config.images)
        stack.callback(recorder.close)
        about: dict[str, Any] = {
            "env": asdict(replace(config.env, num_envs=1)),
            "fingerprint": environment_fingerprint(env),
            "seed": config.seed,
            "only_success": config.only_success,
            "images": config.images,
            "policies": {},
        }
        try:
            for method in methods:
                _collect(method, recorder, config, writer, about["policies"], progress)
        finally:
            if writer.count:
                about = json.loads(json.dumps(about))  # tuples are lists in what is read
                writer.finish(about)
                write_text(config.out / "README.md", card_text(config, about))
    return config.out


def _collect(
    method: Method,
    recorder: RecordingEnv,
    config: CollectConfig,
    writer: DatasetWriter,
    policies: dict[str, Any],
    progress: bool,
) -> None:
    """Run episodes of one policy until enough are kept, and write them in batches.

    `policies` gets under its name a description, and the numbers of episodes `tried`, `solved` and
    `kept`, and of `steps` kept.
    """
    policy = method.make_policy()
    counts = {"tried": 0, "solved": 0, "kept": 0, "steps": 0}
    policies[method.name] = {"described": describe_policy(policy)}
    env = _policy_env(method, recorder, config)
    batch = _BATCH_WITH_IMAGES if config.images else _BATCH
    bar = tqdm(desc=method.name, unit="episode", total=config.episodes, disable=not progress)
    kept: list[RecordedEpisode] = []
    try:
        while counts["kept"] < config.episodes:
            if counts["tried"] >= min(_TRIES * config.episodes + 20, MAX_NUMBER):
                raise ValueError(
                    f"collect_demonstrations: {method.name!r} reached the goal in {counts['solved']} of "
                    f"{counts['tried']} episodes, which is too few to find {config.episodes}; ask for "
                    "fewer, or easier scenes."
                )
            missing = config.episodes - counts["kept"]
            if config.only_success:  # some may fail; idle scenes cost as much as busy ones
                missing = max(missing, config.env.num_envs)
            first = counts["tried"]
            numbers = range(first, min(first + min(missing, batch), MAX_NUMBER))
            for episode in _run(method.name, policy, env, recorder, config, numbers):
                counts["tried"] += 1
                counts["solved"] += episode.success
                if episode.success or not config.only_success:
                    counts["kept"] += 1
                    counts["steps"] += len(episode.action)
                    kept.append(episode)
                    bar.update()
            writer.add(sorted(kept, key=lambda episode: episode.number))
            kept = []
    finally:
        bar.close()
        writer.add(sorted(kept, key=lambda episode: episode.number))
        policies[method.name] |= counts


def _policy_env(method: Method, recorder: RecordingEnv, config: CollectConfig) -> EnvBase:
    """The recorder with the transforms of the environment that the policy was made for."""
    own = method.make_env(recorder.batch_size[0], config.objects)
    transform = own.transform.clone()
    own.close()
    return TransformedEnv(recorder, transform)


def _run(
    name: str,
    policy: Any,
    env: EnvBase,
    recorder: RecordingEnv,
    config: CollectConfig,
    numbers: range,
) -> Iterator[RecordedEpisode]:
    """The episodes of a policy from the starts of these numbers, as they end."""
    rows: dict[int, int] = {}

    def note_row(row: int, number: int) -> None:
        rows[number] = row

    starts = ((number, _start(config, number)) for number in numbers)
    for episode in run_episodes(env, policy, starts, on_step=note_row):
        yield recorder.episode(
            rows[episode.number],
            policy=name,
            number=episode.number,
            seed=episode_seed(config.seed, episode.number),
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
