"""Pictures of stored episodes as in the paper (Sec. V-B), sheets of several pictures, and videos."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from modpush.envs.scenes.conditions import EpisodeConditions
from modpush.envs.scenes.drawing import draw_top_view
from modpush.envs.scenes.objects import PushedObject, get_object
from modpush.envs.scenes.scenario import Scenario
from modpush.evaluation.episodes import Trajectory

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
    """An episode up to a step: start red, goal green, first planned path magenta, arm black.

    Args:
        scenario: Start of the episode.
        trajectory: Course of the episode.
        step: Number of control steps since reset; None for the last.
        caption: Text at the top.
        objects: Your own objects by name, as in `PushEnv.pushed_objects`.
        conditions: Tool, tolerance and map that are drawn; by default those of `EpisodeConditions`.

    Returns:
        `[H, W, 3]` uint8 RGB.
    Source: the paper's figure of example trajectories (Sec. V-B).
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
    """Clips of different lengths next to each other; one that has ended shows its last frame.

    Args:
        clips: Frames `[H, W, 3]` of each clip, all of one height.
    """
    length = max(map(len, clips))
    padded = [[*clip, *[clip[-1]] * (length - len(clip))] for clip in clips]
    return [np.concatenate(frames, axis=1) for frames in zip(*padded, strict=True)]


def contact_sheet(pictures: Sequence[Picture], *, columns: int = 4, width: int = 360) -> Picture:
    """Several pictures on one sheet, row by row.

    Args:
        pictures: The pictures, all of one shape.
        columns: Number of pictures in a row.
        width: Width of each picture on the sheet [px].

    Returns:
        `[H, W, 3]` uint8.

    Raises:
        ValueError: If there are none, or their shapes differ.
    """
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
