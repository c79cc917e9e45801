"""Example episodes of the agent above the same ones of the controller, as in the paper's figure."""

import math

import pandas as pd

from modpush._provenance import sources_text
from modpush.evaluation.pictures import contact_sheet, draw_episode, write_picture
from modpush.evaluation.results import load_trajectory
from modpush.evaluation.sets import EvaluationSet, load_set
from modpush.files import write_text
from modpush.reproduction.config import ReproduceConfig
from modpush.reproduction.measure import AGENT, measure, methods_for

__all__ = ["choose_examples", "write_example_pictures"]

_SET, _CONTROLLER = "obstacles/small_cube", "corridor"
_DETOUR = 1.05  # ratio of shortest path to straight line from which on something stands in the way


def choose_examples(
    agent: pd.DataFrame, controller: pd.DataFrame, episodes: EvaluationSet
) -> list[int]:
    """Numbers of the episodes that are drawn, by a rule and not by eye.

    For each family the first episode that both solved in which the straight line is blocked; and of all
    that both solved the one in which the agent saved most of the object's path.

    Args:
        agent: Rows of the agent.
        controller: Rows of the controller on the same episodes.
        episodes: The evaluation set.
    """
    both = agent["success"].to_numpy(bool) & controller["success"].to_numpy(bool)
    straight = [math.dist(s.object_pose[:2], s.goal_position) for s in episodes.scenarios]
    blocked = agent["shortest_length"].to_numpy() > _DETOUR * agent["episode"].map(
        dict(enumerate(straight))
    )
    chosen = agent[both & blocked].groupby("scene", sort=False)["episode"].first().tolist()
    saved = (controller["path_length"] - agent["path_length"])[both]
    if len(saved):
        chosen.append(int(agent.loc[saved.idxmax(), "episode"]))
    return list(dict.fromkeys(chosen))


def write_example_pictures(config: ReproduceConfig) -> None:
    """Draw the examples as `examples.png` and write `examples.md`.

    Raises:
        ValueError: If the agent and the controller solved no episode in common.
    """
    episodes = load_set(_SET)
    methods = methods_for(config, "small_cube")
    measured = {name: measure(methods[name], episodes, config) for name in (AGENT, _CONTROLLER)}
    agent, controller = (measured[name].rows for name in (AGENT, _CONTROLLER))
    chosen = choose_examples(agent, controller, episodes)
    if not chosen:
        raise ValueError(
            f"write_example_pictures: agent and {_CONTROLLER} solved none of the first "
            f"{len(agent)} episodes of {_SET} in common; run more of them."
        )
    pictures, lines = [], []
    for name, item in measured.items():
        for number in chosen:
            row = item.rows.set_index("episode").loc[number]
            caption = f"{name}: {row['scene']} #{number}, {row['path_length']:.2f} m"
            pictures.append(
                draw_episode(
                    episodes.scenarios[number],
                    load_trajectory(item.folder, number),
                    caption=caption,
                )
            )
    for number in chosen:
        rows = [frame.set_index("episode").loc[number] for frame in (agent, controller)]
        lines.append(
            f"| {number} | {rows[0]['scene']} | {rows[0]['shortest_length']:.3f} | "
            + " | ".join(f"{r['path_length']:.3f} | {r['contact_rate']:.2f}" for r in rows)
            + " |"
        )
    write_picture(config.out / "examples.png", contact_sheet(pictures, columns=len(chosen)))
    sessions = [s for item in measured.values() for s in item.sessions]
    sources = sources_text(config.command("examples"), sessions, f"the set `{_SET}`")
    write_text(config.out / "examples.md", _TEXT.format(sources=sources, rows="\n".join(lines)))


_TEXT = """# Example episodes

{sources}
Above the agent, below the controller in the same episodes: start red, goal green, first planned
path magenta, tool black, object blue, obstacles with their inflation grey. The episodes are chosen
by a rule: of each family the first one that both solved in which the straight line is blocked, and
at last the one in which the agent saved most of the object's path.

![agent above, controller below](examples.png)

| episode | family | shortest path (m) | agent: path (m) | contact | controller: path (m) | contact |
|---|---|---|---|---|---|---|
{rows}

The paper shows four episodes, and says of them that its agent keeps its distance from obstacles
without following the planned path strictly, and that in the fourth it takes a shorter way than the
controller, which depends on its map of costs.
"""
