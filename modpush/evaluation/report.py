"""Tables, pictures and videos of evaluated policies."""

import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from modpush._atomic import make_folder
from modpush._types import NonNegativeInteger
from modpush._validation import checked_arguments
from modpush.envs.scenes.objects import PushedObject
from modpush.evaluation.pictures import (
    contact_sheet,
    draw_episode,
    draw_frames,
    write_picture,
    write_video,
)
from modpush.evaluation.results import load_trajectory
from modpush.evaluation.sets import EvaluationSet
from modpush.evaluation.tables import (
    LEGEND,
    check_rows,
    compare,
    format_table,
    summarize,
    to_display,
)


@checked_arguments
def write_tables(rows: pd.DataFrame, folder: Path | str) -> str:
    """Write means over all episodes and over each scene family as `table.csv` and `table.md`.

    Args:
        rows: A row for each episode, as `evaluate` returns them.
        folder: Folder to write to.

    Returns:
        The table in Markdown.
    """
    check_rows({"all": rows})
    folder = make_folder(folder)
    by_scene = {str(scene): frame for scene, frame in rows.groupby("scene", sort=False)}
    table = pd.concat(
        [summarize({name: frame}) for name, frame in [("all", rows), *by_scene.items()]]
    ).rename_axis("scene")
    text = format_table(to_display(table))
    (folder / "table.csv").write_text(table.to_csv(), encoding="utf-8")
    (folder / "table.md").write_text(f"{text}\n{LEGEND}", encoding="utf-8")
    return text


@checked_arguments
def draw_results(
    rows: pd.DataFrame,
    episodes: EvaluationSet,
    folder: Path | str,
    policy: str,
    *,
    pictures: NonNegativeInteger = 24,
    videos: bool = True,
    objects: Mapping[str, PushedObject] | None = None,
) -> None:
    """Draw failed and solved episodes, spread over the set, and a video of each scene family.

    Writes `failures.png`, `successes.png` and `videos/<family>.mp4`.

    Args:
        rows: A row for each episode, as `evaluate` returns them.
        episodes: The evaluation set.
        folder: Folder in which `evaluate` stored its results; the pictures are added to it.
        policy: Name of the policy, for the captions.
        pictures: Maximum number of failed episodes to draw; at most half as many solved ones are drawn.
        videos: Write the videos, too.
        objects: Your own objects by name, as in `PushEnv.pushed_objects`.
    """
    check_rows({"all": rows})
    folder = Path(folder)
    look: Any = {"objects": objects, "conditions": episodes.conditions}
    load = functools.partial(load_trajectory, folder)
    for name, solved, most in (("failures", False, pictures), ("successes", True, pictures // 2)):
        chosen = rows[rows["success"] == solved]
        spread = np.linspace(0, len(chosen) - 1, min(len(chosen), most)).round().astype(int)
        chosen = chosen.iloc[spread]
        path = folder / f"{name}.png"
        path.unlink(missing_ok=True)
        drawn = [
            draw_episode(
                episodes.scenarios[row.episode],
                load(row.episode),
                caption=f"{row.episode} {row.scene}: {'solved' if solved else 'failed'}, "
                f"{row.steps} steps{', out of bounds' if row.out_of_bounds else ''}",
                **look,
            )
            for row in chosen.itertuples()
        ]
        if drawn:
            write_picture(path, contact_sheet(drawn))
    for scene, frame in rows.groupby("scene") if videos else ():
        number = int(frame["episode"].iloc[0])
        frames = draw_frames(
            episodes.scenarios[number],
            load(number),
            caption=f"{policy}: {scene}, #{number}",
            **look,
        )
        write_video(folder / "videos" / f"{scene}.mp4", frames)


@checked_arguments
def comparison_report(rows: Mapping[str, pd.DataFrame]) -> str:
    """Several policies over the episodes that all of them solved, with tests of the first against each.

    Args:
        rows: A row for each episode, as `evaluate` returns them, by policy.

    Returns:
        Tables in Markdown.

    Raises:
        ValueError: If the policies ran different episodes.
    """
    text = (
        f"Metrics over the episodes that all solved\n\n{format_table(to_display(summarize(rows)))}"
    )
    (first, a), *others = rows.items()
    for second, b in others:
        text += f"\n{first} against {second}\n\n{format_table(compare(a, b))}"
    return f"{text}\n{LEGEND}"
