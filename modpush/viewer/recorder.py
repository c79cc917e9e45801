"""`Recorder`: a video of what a session shows, drawn from above."""

from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modpush.envs.scenes.drawing import draw_top_view
from modpush.envs.scenes.objects import get_object
from modpush.viewer.config import CONTROL_FREQ
from modpush.viewer.lane import Snapshot

__all__ = ["Recorder", "draw_snapshots"]


def draw_snapshots(names: Sequence[str], snapshots: Sequence[Snapshot]) -> NDArray[np.uint8]:
    """Top views of all lanes side by side, `[H, W, 3]` uint8 RGB."""
    return np.hstack(
        [
            draw_top_view(
                shown.scenario,
                shown.object_pose,
                shown.ee_pose,
                planned_path=shown.path,
                subgoal=shown.subgoal,
                inflation=get_object(shown.scenario.pushed_object).radius,
                caption=f"{name}: step {shown.step}",
            )
            for name, shown in zip(names, snapshots, strict=True)
        ]
    )


class Recorder:
    """Writes an MP4 frame by frame.

    Args:
        folder: Folder that the video is written to.
    """

    def __init__(self, folder: Path) -> None:
        import imageio  # heavy, and only a recording needs it

        folder.mkdir(parents=True, exist_ok=True)
        self.path = folder / f"{datetime.now():%Y%m%d-%H%M%S}.mp4"
        """The video."""
        self._writer: Any = imageio.get_writer(self.path, fps=CONTROL_FREQ, macro_block_size=2)
        self._width = 0
        self.frames = 0
        """Number of frames so far. Without any there is no file."""

    def add(self, names: Sequence[str], snapshots: Sequence[Snapshot]) -> bool:
        """Add a frame; False if the number of lanes has changed since the first one."""
        frame = draw_snapshots(names, snapshots)
        self._width = self._width or frame.shape[1]
        if frame.shape[1] != self._width:
            return False
        self._writer.append_data(frame)
        self.frames += 1
        return True

    def close(self) -> None:
        """Finish the video."""
        self._writer.close()
