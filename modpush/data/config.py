"""`CollectConfig`, the seeds of the starts, and the card of a data set of demonstrations."""

from collections.abc import Mapping
from dataclasses import asdict, field, replace
from pathlib import Path
from typing import Annotated, Any

from annotated_types import Le
from pydantic import StringConstraints

import modpush
from modpush._types import AtLeastOne, Count, FilePath, Name, NonNegativeInteger, Several
from modpush._validation import checked
from modpush.files import dump_yaml
from modpush.recipes.config import END_TO_END, PushEnvConfig

MAX_NUMBER = 1_000_000
"""Number of starts that there are for one seed."""
_FIRST_SEED = 1_000_000_000


def episode_seed(seed: int, number: int) -> int:
    """Seed from which the start of an episode is drawn.

    It is between 1e9 and 2^32. The evaluation sets and the episodes held out in training are drawn
    with smaller first words, so that none of their starts is among the demonstrations.

    Args:
        seed: Seed of the data set.
        number: Number of the start, below `MAX_NUMBER`.
    """
    return _FIRST_SEED + MAX_NUMBER * seed + number


@checked
class CollectConfig:
    """Settings of `collect_demonstrations`."""

    policy: AtLeastOne[Name] = ("agent",)
    """Policies to record: `agent`, `corridor`, `corridor_faithful`, `scripted`, a training run's
    folder, or an agent's file. Each of their episodes is labelled with the policy's name."""
    episodes: Annotated[Count, Le(MAX_NUMBER)] = 100
    """Number of episodes to keep for each policy."""
    only_success: bool = False
    """Keep only episodes that reach the goal; failed ones are replaced by further episodes."""
    images: bool = False
    """Also store depth and segmentation images (some 2 kB per step)."""
    env: PushEnvConfig = field(default_factory=lambda: PushEnvConfig.preset("cpu", num_envs=8))
    """Environment whose observations, actions and rewards are recorded. Policies made for another
    environment observe their own; their actions are turned into the axes of this one."""
    seed: Annotated[NonNegativeInteger, Le(3000)] = 0
    """Seed of the starts. Different seeds have different starts, and none is in an evaluation set."""
    name: Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9_]+$")] = "push"
    """Name of the data set: letters, digits and underscores. Minari calls it `modpush/<name>-v0`."""
    licence: Name = "MIT"
    """Licence that the card states."""
    allow: Several[Name] = ()
    """Modules from which an agent's file may import its author's own parts."""
    out: FilePath = Path("runs/demonstrations")
    """Folder to write to, without a data set."""

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
    """The card as Markdown: policies, environment, and how the data set is read.

    Args:
        config: Settings of the data set.
        about: The data set's metadata: counts of episodes by policy, and the environment's config.
    """
    shown = {name: about[name] for name in ("policies", "only_success", "images", "env")}
    return _CARD.format(
        licence=config.licence,
        name=config.dataset_id,
        version=modpush.__version__,
        first_seed=episode_seed(config.seed, 0),
        settings=dump_yaml(shown),
    )
