"""Checkpoints of a training run: one sealed file each."""

import re
import warnings
from pathlib import Path
from typing import Any

from modpush._state import read_state, write_state

__all__ = ["CHECKPOINT_KIND", "CHECKPOINT_VERSION", "Checkpoints"]

CHECKPOINT_KIND, CHECKPOINT_VERSION = "modpush.Checkpoint", 1
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
        return sorted((path for path in files if _NAME.fullmatch(path.name)), key=self.step)

    def latest(self) -> Path | None:
        """The newest checkpoint, if there is one."""
        paths = self.paths()
        return paths[-1] if paths else None

    @staticmethod
    def is_checkpoint(path: Path) -> bool:
        """Whether a path has a checkpoint's name."""
        return _NAME.fullmatch(path.name) is not None

    @staticmethod
    def step(path: Path) -> int:
        """Environment steps after which a checkpoint was written."""
        found = _NAME.fullmatch(path.name)
        assert found is not None
        return int(found[1])

    def save(self, step: int, state: dict[str, Any]) -> None:
        """Write a checkpoint, then remove those that are too old.

        Raises:
            OSError: If it cannot be written; those before stay.
        """
        write_state(
            self.folder / f"step-{step:09d}.safetensors", state, CHECKPOINT_KIND, CHECKPOINT_VERSION
        )
        for path in self.paths()[: -self.keep]:
            path.unlink()

    def load(self) -> dict[str, Any]:
        """The state in the newest intact checkpoint; damaged ones are renamed, with a warning.

        Raises:
            FileNotFoundError: If there is none.
            ValueError: If all are damaged.
        """
        if not self.paths():
            raise FileNotFoundError(f"Checkpoints: {self.folder} holds no checkpoint.")
        errors = []
        for path in reversed(self.paths()):
            try:
                state: dict[str, Any] = read_state(path, CHECKPOINT_KIND, CHECKPOINT_VERSION)
                break
            except ValueError as error:
                errors.append((path, error))
        else:
            reasons = "; ".join(str(error) for _, error in errors)
            raise ValueError(f"Checkpoints: no checkpoint in {self.folder} is intact: {reasons}")
        for damaged, reason in errors:
            damaged.rename(damaged.with_name(f"{damaged.name}.damaged"))
            warnings.warn(
                f"Checkpoints: {reason} It was renamed to {damaged.name}.damaged; the run continues "
                f"from the one before, {path.name}.",
                stacklevel=2,
            )
        return state
