"""Tables, pictures as in the paper (Sec. V-B) and videos of evaluated policies."""

import functools
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
from numpy.typing import NDArray

from modpush._atomic import make_folder
from modpush._types import NonNegativeInteger
from modpush._validation import checked_arguments
from modpush.envs.scenes.conditions import EpisodeConditions
from modpush.envs.scenes.drawing import draw_top_view
from modpush.envs.scenes.objects import PushedObject, get_object
from modpush.envs.scenes.scenario import Scenario
from modpush.evaluation.episodes import Trajectory
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

_CONTROL_FREQ = 15  # control steps per second of all evaluations [Hz]
Picture = NDArray[np.uint8]


def draw_episode(
    scenario: Scenario,
    trajectory: Trajectory,
    *,
    step: int | None = None,
    caption: str = "",
    objects: Mapping[str, PushedObject] | None = None,
    conditions: EpisodeConditions | None = None,
) -> Picture:
    """An episode up to a step: start red, goal green, first planned path magenta, arm black; RGB.

    `step` is the number of control steps since reset, None for the last. `objects` are your own ones by
    name, and `conditions` have the tool, tolerance and map that are drawn. Source: the paper's figure of
    example trajectories (Sec. V-B).
    """
    last = len(trajectory.object_pose) - 1
    step = last if step is None else min(step, last)
    object_poses = trajectory.object_pose[: step + 1]
    tool_poses = trajectory.ee_pose[: step + 1]
    targets = trajectory.target
    conditions = conditions or EpisodeConditions()
    return draw_top_view(
        scenario,
        object_poses[-1].tolist(),
        tool_poses[-1].tolist(),
        object_path=object_poses.astype(np.float64),
        ee_path=tool_poses.astype(np.float64),
        planned_path=trajectory.planned_path.astype(np.float64),
        subgoal=targets[min(step, len(targets) - 1)].tolist() if len(targets) else None,
        obstacle_poses=_obstacle_poses(scenario, trajectory, step),
        inflation=get_object(scenario.pushed_object, objects).radius_of(conditions.inflation),
        caption=caption,
        tool=conditions.tool,
        objects=objects,
        position_tolerance=conditions.position_tolerance,
    )


def _obstacle_poses(scenario: Scenario, trajectory: Trajectory, step: int) -> NDArray[np.float64]:
    """x, y, yaw of the obstacles after a step, `[n, 3]`."""
    if trajectory.obstacle_pose is not None:
        return trajectory.obstacle_pose[step, :, :3].astype(np.float64)
    time = step / _CONTROL_FREQ
    return np.reshape([o.standing(time).pose for o in scenario.obstacles], (-1, 3))


def draw_frames(
    scenario: Scenario,
    trajectory: Trajectory,
    *,
    every: int = 1,
    **options: Any,
) -> Iterable[Picture]:
    """A picture of every so many steps, and of the last one; arguments as in `draw_episode`."""
    last = len(trajectory.object_pose) - 1
    for step in [*range(0, last, every), last]:
        yield draw_episode(scenario, trajectory, step=step, **options)


def join_clips(clips: Sequence[Sequence[Picture]]) -> list[Picture]:
    """Clips of different lengths and one height side by side; one that has ended shows its last frame."""
    length = max(map(len, clips))
    padded = [[*clip, *[clip[-1]] * (length - len(clip))] for clip in clips]
    return [np.concatenate(frames, axis=1) for frames in zip(*padded, strict=True)]


def contact_sheet(pictures: Sequence[Picture], *, columns: int = 4, width: int = 360) -> Picture:
    """Pictures of one shape on one sheet, row by row, each `width` pixels wide."""
    shapes = {picture.shape for picture in pictures}
    if len(shapes) != 1:
        raise ValueError(f"contact_sheet: expected pictures of one shape, got {sorted(shapes)}.")
    height = round(pictures[0].shape[0] * width / pictures[0].shape[1])
    small = [cv2.resize(p, (width, height), interpolation=cv2.INTER_AREA) for p in pictures]
    columns = min(columns, len(small))
    small += [np.full_like(small[0], 255)] * (-len(small) % columns)
    rows = [np.hstack(small[i : i + columns]) for i in range(0, len(small), columns)]
    return np.vstack(rows)


def write_picture(path: Path, picture: Picture) -> None:
    """Write a PNG."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if not cv2.imwrite(str(path), picture[..., ::-1]):
        raise OSError(f"write_picture: could not write {path}.")


def write_video(path: Path, frames: Iterable[Picture], fps: int = 15) -> None:
    """Write an MP4; frames need even sides, as `draw_episode`'s have."""
    import imageio  # heavy, and only this function needs it

    path.parent.mkdir(parents=True, exist_ok=True)
    with imageio.get_writer(path, fps=fps, macro_block_size=2) as writer:
        for frame in frames:
            writer.append_data(frame)


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
