"""Example episodes of the agent above the same ones of the controller, as in the paper's figure."""

import math

import pandas as pd

from modpush.evaluation import EvaluationSet, load_set
from modpush.evaluation.report import contact_sheet, draw_episode, write_picture
from modpush.evaluation.results import load_trajectory
from paper.measure import Running, find_method, measure
from paper.provenance import origin_of, sources_text
from paper.rows import ROWS

__all__ = ["choose_examples", "write_examples"]

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


def write_examples(running: Running, agent: str = "small_cube", first: int | None = None) -> str:
    """Draw episodes of an agent and the controller, chosen by a rule.

    Draws `examples.png` beside the rows, and returns their table in Markdown.

    Args:
        running: How episodes are run; those of the agent and the controller that are missing.
        agent: The agent.
        first: Number of episodes to choose from, starting with the first of the set; all by default.

    Raises:
        ValueError: If the agent and the controller solved no episode in common.
    """
    episodes = load_set(_SET).first(first)
    found = dict(map(find_method, (agent, _CONTROLLER)))
    folders = {name: running.folder / name / _SET for name in found}
    rows = [
        measure(method, episodes, folders[name], running).set_index("episode", drop=False)
        for name, method in found.items()
    ]
    ours, theirs = (frame.reset_index(drop=True) for frame in rows)
    chosen = choose_examples(ours, theirs, episodes)
    if not chosen:
        raise ValueError(
            f"write_examples: {agent} and {_CONTROLLER} solved none of the first {len(episodes)} "
            f"episodes of {_SET} in common; run more of them."
        )
    pictures, lines = [], []
    for name, frame in zip(found, rows, strict=True):
        for number in chosen:
            row = frame.loc[number]
            caption = f"{name}: {row['scene']} #{number}, {row['path_length']:.2f} m"
            trajectory = load_trajectory(folders[name], number)
            pictures.append(draw_episode(episodes.scenarios[number], trajectory, caption=caption))
    for number in chosen:
        both = [frame.loc[number] for frame in rows]
        cells = [f"{row['path_length']:.3f} | {row['contact_rate']:.2f}" for row in both]
        start = f"{number} | {both[0]['scene']} | {both[0]['shortest_length']:.3f}"
        lines.append(f"| {start} | {' | '.join(cells)} |")
    write_picture(
        ROWS.parent / "examples.png", contact_sheet(pictures, columns=len(chosen), width=300)
    )
    origins = [origin_of(folder) for folder in folders.values()]
    sources = sources_text("python -m paper examples", f"the set `{_SET}`", origins)
    ways = ("agent: path (m)", "contact", "controller: path (m)", "contact")
    heads = ("episode", "family", "shortest path (m)", *ways)
    table = [f"| {' | '.join(heads)} |", "|" + "---|" * len(heads), *lines]
    return "\n".join([sources, *table]) + "\n"
