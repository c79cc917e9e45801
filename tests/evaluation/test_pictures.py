from pathlib import Path

import cv2
import numpy as np
import pytest

from modpush.envs.scenes.conditions import EpisodeConditions
from modpush.envs.scenes.drawing import draw_top_view, to_pixels
from modpush.envs.scenes.objects import get_object
from modpush.evaluation.pictures import (
    contact_sheet,
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


def test_obstacles_have_a_rim_as_wide_as_the_object_is_round() -> None:
    bar = SLOT.obstacles[0]
    radius = get_object(SLOT.pushed_object).radius
    picture = draw_top_view(SLOT, (9.0, 9.0, 0.0), (9.0, 9.0, 0.0), inflation=radius)
    bare = draw_top_view(SLOT, (9.0, 9.0, 0.0), (9.0, 9.0, 0.0))
    side = bar.pose[0] + bar.size[1] / 2  # the bar lies across, along y
    inside, outside = ((side + share * radius, bar.pose[1] - 0.05) for share in (0.85, 1.2))
    assert colour_at(picture, bar.pose[:2]) == (96, 102, 112)
    assert colour_at(picture, inside) == (205, 206, 208)
    assert colour_at(picture, outside) == colour_at(bare, outside)
    assert colour_at(bare, inside) != (205, 206, 208)


def test_an_episode_shows_path_target_object_and_tool() -> None:
    picture = draw_episode(SLOT, EPISODE.trajectory)
    plain = draw_top_view(SLOT, EPISODE.trajectory.object_pose[-1], EPISODE.trajectory.ee_pose[-1])
    assert count_magenta(picture) > 50
    assert count_magenta(plain) == 0
    start = draw_episode(SLOT, EPISODE.trajectory, step=0)
    assert colour_at(start, SLOT.object_pose[:2]) == (40, 90, 200)  # the object, at its start
    assert colour_at(picture, SLOT.object_pose[:2]) != (40, 90, 200) or (start != picture).any()


def test_contact_sheet() -> None:
    pictures = [np.full((20, 40, 3), value, np.uint8) for value in (10, 20, 30)]
    sheet = contact_sheet(pictures, columns=2, width=40)
    assert sheet.shape == (40, 80, 3)
    assert [sheet[0, 0, 0], sheet[0, 79, 0], sheet[39, 0, 0], sheet[39, 79, 0]] == [10, 20, 30, 255]
    with pytest.raises(ValueError, match="expected pictures of one shape"):
        contact_sheet([pictures[0], pictures[1][:10]])
    with pytest.raises(ValueError, match=r"one shape, got \[\]"):
        contact_sheet([])


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
