"""The card of a data set of demonstrations."""

from collections.abc import Mapping
from typing import Any

import pandas as pd
from torch import nn

import modpush
from modpush._hash import weights_hash
from modpush.data.config import CollectConfig, episode_seed

__all__ = ["card_text"]


def card_text(
    config: CollectConfig, rows: pd.DataFrame, tried: pd.DataFrame, about: Mapping[str, Any]
) -> str:
    """The card as Markdown: what was recorded, how, and how it is read.

    Args:
        config: What was collected.
        rows: A row for each episode in the data set.
        tried: A row for each episode that was run.
        about: `policies` and `fingerprint` of the data set.
    """
    env, drawn = config.env, config.env.scenario
    kept = "episodes that reached the goal" if config.only_success else "all episodes"
    width = about["fingerprint"]["observation"]["entries"][-1]["columns"][1]
    files = {
        "minari": f"- `minari/{config.dataset_id}`: observations, actions and rewards of "
        f"`modpush/Push-v0` ({width} numbers in the {env.frame}'s axes)",
        "maniskill": "- `trajectory.h5`, `trajectory.json`: states, state observations and commands "
        "of `ClutterPush-v1`",
    }
    return "\n".join(
        [
            "---",
            f"license: {config.licence.lower()}",
            "tags: [robotics, pushing, demonstrations, modpush]",
            "---",
            f"# Demonstrations `{config.dataset_id}`",
            "",
            f"A UR5 pushes an object through clutter to a goal: {len(rows)} episodes, "
            f"{int(rows['steps'].sum())} steps at 15 Hz, recorded with modpush "
            f"{modpush.__version__}. Kept are {kept}"
            f"{'; with depth and segmentation images' if config.images else ''}.",
            "",
            *_policies(rows, tried, about["policies"]),
            "",
            f"- starts: drawn from the seeds {episode_seed(config.seed, 0)} + number of the episode, "
            "the same for all policies; none is in an evaluation set",
            f"- scenes: {', '.join(drawn.scene)}; difficulty {drawn.difficulty[0]:g} to "
            f"{drawn.difficulty[1]:g}, distance {drawn.distance[0]:g} to {drawn.distance[1]:g} m",
            f"- objects: {', '.join(config.objects)}",
            f"- licence: {config.licence}",
            *(files[name] for name in config.formats),
            "- `episodes/`, `attempts.csv`: what the run goes on from; not needed any more to read "
            "the rest",
            "",
            "```python",
            "from modpush.data import load_demonstrations",
            "",
            'demonstrations = load_demonstrations("this folder")',
            "print(demonstrations.transitions)",
            "env = demonstrations.make_env(num_envs=8)",
            "```",
            "",
        ]
    )


def _policies(
    rows: pd.DataFrame, tried: pd.DataFrame, policies: Mapping[str, Mapping[str, Any]]
) -> list[str]:
    """A table with a row for each policy."""
    lines = [
        "| policy | class | weights | episodes | steps | success when run | of episodes |",
        "|---|---|---|---|---|---|---|",
    ]
    nothing = weights_hash(nn.Module())
    for name, about in policies.items():
        mine, run = rows[rows["policy"] == name], tried[tried["policy"] == name]
        kind = str(about["class"]).rpartition(":")[2]
        weights = about.get("weights", nothing)
        lines.append(
            f"| {name} | {kind} | {'–' if weights == nothing else weights} | {len(mine)} | "
            f"{int(mine['steps'].sum())} | {run['success'].mean():.3f} | {len(run)} |"
        )
    return lines
