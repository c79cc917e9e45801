"""One process at a time may write to a folder."""

from pathlib import Path

from filelock import FileLock, Timeout

from modpush._atomic import make_folder

__all__ = ["FolderLock", "FolderLockedError"]


class FolderLockedError(OSError):
    """Another process writes to the folder."""


class FolderLock:
    """A folder that no other process may write to. The lock ends with the process, however that ends.

    Args:
        folder: The folder; made if it is not there.

    Raises:
        FolderLockedError: If another process, or another lock of this one, holds it.
        NotADirectoryError: If it, or a folder that it lies in, is a file.
        OSError: If the folder cannot be written to.
    """

    def __init__(self, folder: Path | str) -> None:
        self._lock = FileLock(make_folder(folder) / ".lock", blocking=False)
        try:
            self._lock.acquire()
        except Timeout:
            raise FolderLockedError(
                f"{folder} is in use by another process. Wait for it, end it, or take another folder."
            ) from None

    def release(self) -> None:
        """Let others write to the folder."""
        self._lock.release()

    def __enter__(self) -> "FolderLock":
        return self

    def __exit__(self, *_: object) -> None:
        self.release()
