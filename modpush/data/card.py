"""The card of a data set of demonstrations."""

from collections.abc import Mapping
from typing import Any

import pandas as pd

import modpush
from modpush.data.config import CollectConfig, episode_seed

__all__ = ["card_text"]

_CARD = """---
license: {licence}
tags: [robotics, pushing, demonstrations, modpush]
---
# Demonstrations `{name}`

A UR5 pushes an object through clutter to a goal: {episodes} episodes, {steps} steps at 15 Hz, recorded
with modpush {version}. Kept are {kept}{images}.

{policies}

- starts: drawn from the seeds {first_seed} + number of the episode, the same for all policies; none is
  in an evaluation set
- scenes: {scenes}; difficulty {difficulty}, distance {distance} m
- objects: {objects}
- licence: {licence_name}
- `minari/{name}`: observations, actions and rewards of `modpush/Push-v0` ({width} numbers in the
  {frame}'s axes)

```python
from modpush.data import load_demonstrations

demonstrations = load_demonstrations("this folder")
print(demonstrations.transitions)
env = demonstrations.make_env(num_envs=8)
```
"""


def card_text(config: CollectConfig, about: Mapping[str, Any]) -> str:
    """The card as Markdown: policies, starts, scenes, and how the data set is read.

    Args:
        config: Settings of the data set.
        about: The data set's metadata: counts of episodes by policy, and the environment's fingerprint.
    """
    drawn = config.env.scenario
    table = pd.DataFrame(
        {
            "policy": name,
            "class": str(policy["described"]["class"]).rpartition(":")[2],
            "weights": policy["described"].get("weights", "–"),
            "episodes": policy["kept"],
            "steps": policy["steps"],
            "success when run": policy["solved"] / max(policy["tried"], 1),
            "of episodes": policy["tried"],
        }
        for name, policy in about["policies"].items()
    )
    return _CARD.format(
        licence=config.licence.lower(),
        licence_name=config.licence,
        name=config.dataset_id,
        episodes=table["episodes"].sum(),
        steps=table["steps"].sum(),
        version=modpush.__version__,
        kept="episodes that reached the goal" if config.only_success else "all episodes",
        images="; with depth and segmentation images" if config.images else "",
        policies=table.to_markdown(index=False, floatfmt=".3f"),
        first_seed=episode_seed(config.seed, 0),
        scenes=", ".join(drawn.scene),
        difficulty="{:g} to {:g}".format(*drawn.difficulty),
        distance="{:g} to {:g}".format(*drawn.distance),
        objects=", ".join(config.objects),
        width=about["fingerprint"]["observation"]["entries"][-1]["columns"][1],
        frame=config.env.frame,
    )
