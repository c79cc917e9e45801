"""Checkpoints of a training run: one file each, with a checksum."""

import re
from pathlib import Path
from typing import Any

from modpush._state import read_state, write_state

__all__ = ["CHECKPOINT_KIND", "Checkpoints", "read_checkpoint"]

CHECKPOINT_KIND, _VERSION = "modpush.Checkpoint", 1
_NAME = re.compile(r"step-(\d+)\.safetensors")


class Checkpoints:
    """The newest checkpoints in a folder, `step-<steps>.safetensors`.

    Args:
        folder: The folder.
        keep: How many are kept.
    """

    def __init__(self, folder: Path, keep: int = 2) -> None:
        self.folder, self.keep = folder, keep

    def paths(self) -> list[Path]:
        """All checkpoints, the newest last."""
        files = self.folder.iterdir() if self.folder.is_dir() else ()
        return sorted(filter(self.is_checkpoint, files), key=self.step)

    def latest(self) -> Path | None:
        """The newest checkpoint, if there is one."""
        return max(self.paths(), key=self.step, default=None)

    @staticmethod
    def is_checkpoint(path: Path) -> bool:
        """True if a path has a checkpoint's name."""
        return _NAME.fullmatch(path.name) is not None

    @staticmethod
    def step(path: Path) -> int:
        """Environment steps after which a checkpoint was written."""
        return int(path.stem.removeprefix("step-"))

    def save(self, step: int, state: dict[str, Any]) -> None:
        """Write a checkpoint, then remove those that are too old.

        Raises:
            OSError: If it cannot be written; those before stay.
        """
        path = self.folder / f"step-{step:09d}.safetensors"
        write_state(path, state, CHECKPOINT_KIND, _VERSION)
        for old in self.paths()[: -self.keep]:
            old.unlink()

    def load(self) -> dict[str, Any]:
        """The state in the newest checkpoint.

        Raises:
            FileNotFoundError: If there is none.
            ValueError: If it is damaged; without its file a run resumes from the checkpoint before.
        """
        newest = self.latest()
        if newest is None:
            raise FileNotFoundError(f"Checkpoints: {self.folder} holds no checkpoint.")
        try:
            return read_checkpoint(newest)
        except ValueError as error:
            raise ValueError(f"{error} Delete the file to resume from the one before.") from error


def read_checkpoint(path: Path) -> dict[str, Any]:
    """The state in a checkpoint's file; interpret it within `reading(path, CHECKPOINT_KIND)`.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is damaged.
    """
    state: dict[str, Any] = read_state(path, CHECKPOINT_KIND, _VERSION)
    return state
