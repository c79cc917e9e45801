"""A full disk must not end a training run."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["DiskGuard"]


class DiskGuard:
    """Lets a run go on where a file cannot be written, with one warning until it can be again."""

    def __init__(self) -> None:
        self._failing: set[str] = set()

    @contextmanager
    def __call__(self, what: str) -> Iterator[None]:
        """Write something in this block; what was there before stays if it cannot be written.

        Args:
            what: What is written, for the warning.
        """
        try:
            yield
        except OSError as error:
            if what not in self._failing:
                warnings.warn(
                    f"Trainer: {what} could not be written ({error}); the previous one is kept, and "
                    "training continues. Writing is tried again whenever it is due.",
                    stacklevel=3,
                )
            self._failing.add(what)
        else:
            self._failing.discard(what)
