"""Files that are replaced atomically, and folders to which one process at a time may write."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout


@contextmanager
def replacing(path: Path | str) -> Iterator[Path]:
    """Write to a temporary file beside `path`, which replaces it when the block ends without an error.

    Until then, and after an error or a kill, `path` is as it was before. The new content is on disk
    before the name is. A temporary file that a killed process left is written over by the next attempt.

    Raises:
        OSError: If it cannot be written, or the path or its folder is of the other kind; the message
        names it.
    """
    path = Path(path)
    if path.is_dir():
        raise IsADirectoryError(f"{path} is a folder, expected the path of a file.")
    make_folder(path.parent)
    unfinished = path.with_name(f".{path.name}.tmp")
    try:
        yield unfinished
        with unfinished.open("rb+") as file:
            os.fsync(file.fileno())
        unfinished.replace(path)
    except OSError as error:
        reason = f"the file cannot be written ({error.strerror or error})"
        raise type(error)(error.errno, reason, str(path)) from error
    finally:
        unfinished.unlink(missing_ok=True)


def make_folder(path: Path | str) -> Path:
    """Make a folder unless it is there; an OSError names what is in the way."""
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        raise NotADirectoryError(f"{folder} is or lies in a file, expected a folder.") from None
    except OSError as error:  # in words that the command line shows without a traceback
        reason = f"no folder can be made ({error.strerror})"
        raise type(error)(error.errno, reason, str(folder)) from None
    return folder


class FolderLockedError(OSError):
    """Another process writes to the folder."""


class FolderLock:
    """A folder, made if it is not there, that no other process may write to until this one ends.

    Raises:
        FolderLockedError: If another process, or another lock of this one, holds it.
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
