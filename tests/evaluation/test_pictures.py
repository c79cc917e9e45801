from pathlib import Path

import cv2
import numpy as np

from modpush.envs.scenes.conditions import EpisodeConditions
from modpush.envs.scenes.drawing import draw_top_view, to_pixels
from modpush.evaluation.report import (
    draw_episode,
    draw_frames,
    write_picture,
    write_video,
)
from modpush.evaluation.sets import load_set
from tests.evaluation.conftest import make_episode

SLOT = next(s for s in load_set("smoke") if s.scene == "slot")
EPISODE = make_episode(0, SLOT, success=False)  # stops halfway, so that the path shows


def colour_at(picture: np.ndarray, point) -> tuple[int, ...]:
    u, v = to_pixels(np.array(point)) // 16
    return tuple(int(c) for c in picture[v, u])


def count_magenta(picture: np.ndarray) -> int:
    """Lines are antialiased, so hardly a pixel has the colour itself."""
    return int((np.abs(picture.astype(int) - [200, 40, 190]).max(-1) < 40).sum())


def test_an_episode_shows_path_target_object_and_tool() -> None:
    picture = draw_episode(SLOT, EPISODE.trajectory)
    plain = draw_top_view(SLOT, EPISODE.trajectory.object_pose[-1], EPISODE.trajectory.ee_pose[-1])
    assert count_magenta(picture) > 50
    assert count_magenta(plain) == 0
    start = draw_episode(SLOT, EPISODE.trajectory, step=0)
    assert colour_at(start, SLOT.object_pose[:2]) == (40, 90, 200)  # the object, at its start
    assert colour_at(picture, SLOT.object_pose[:2]) != (40, 90, 200) or (start != picture).any()


def test_files(tmp_path: Path) -> None:
    picture = draw_episode(SLOT, EPISODE.trajectory)
    write_picture(tmp_path / "a" / "b.png", picture)
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "a" / "b.png"))[..., ::-1], picture)
    write_video(tmp_path / "c.mp4", draw_frames(SLOT, EPISODE.trajectory))
    capture = cv2.VideoCapture(str(tmp_path / "c.mp4"))
    frames = 0
    while capture.read()[0]:
        frames += 1
    assert frames == 3


def test_pictures_show_the_tool_and_the_map_of_the_set() -> None:
    def shown(**conditions: str) -> np.ndarray:
        return draw_episode(SLOT, EPISODE.trajectory, conditions=EpisodeConditions(**conditions))

    plain = draw_episode(SLOT, EPISODE.trajectory)
    assert (shown() == plain).all()
    rod = shown(tool="rod")
    x, y, yaw = EPISODE.trajectory.ee_pose[-1]
    beside = (x - 0.02 * np.sin(yaw), y + 0.02 * np.cos(yaw))  # within the gripper, outside the rod
    across = (x + 0.02 * np.cos(yaw), y + 0.02 * np.sin(yaw))
    changed = [colour_at(rod, p) != colour_at(plain, p) for p in (beside, across)]
    assert sum(changed) == 1
    rim = (np.array([205, 206, 208]) == shown(inflation="inscribed")).all(-1).sum()
    assert rim < 0.8 * (np.array([205, 206, 208]) == plain).all(-1).sum()
