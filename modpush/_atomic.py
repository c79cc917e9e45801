"""Replacing files atomically."""

import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

__all__ = ["clean_leftovers", "make_folder", "replacing"]

_HOST = socket.gethostname()


@contextmanager
def replacing(path: Path | str) -> Iterator[Path]:
    """Write to a temporary file that takes the place of `path` when the block ends without an error.

    Until then, and after an error or a kill, `path` is as it was before. The new content is on disk
    before the name is, and both are when this returns. What a killed process left of an earlier
    attempt is removed.

    Args:
        path: The file to replace; its folder is made.

    Yields:
        The temporary file's path, in the same folder.

    Raises:
        IsADirectoryError: If the path is a folder.
        NotADirectoryError: If its folder is or lies in a file.
    """
    path = Path(path)
    if path.is_dir():
        raise IsADirectoryError(f"{path} is a folder, expected the path of a file.")
    make_folder(path.parent)
    clean_leftovers(path.parent, path.name)
    unfinished = path.with_name(f".{path.name}.{_HOST}.{os.getpid()}.tmp")
    try:
        yield unfinished
        with unfinished.open("rb+") as file:
            os.fsync(file.fileno())
        unfinished.replace(path)
        _sync(path.parent)
    finally:
        unfinished.unlink(missing_ok=True)


def make_folder(path: Path | str) -> Path:
    """Make a folder unless it is there.

    Raises:
        NotADirectoryError: If it, or a folder that it lies in, is a file.
        OSError: If it cannot be made, for instance on a disk that is only read.
    """
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        raise NotADirectoryError(f"{folder} is or lies in a file, expected a folder.") from None
    except OSError as error:  # in words that the command line shows without a traceback
        reason = f"no folder can be made ({error.strerror})"
        raise type(error)(error.errno, reason, str(folder)) from None
    return folder


def clean_leftovers(folder: Path | str, name: str = "*") -> None:
    """Remove temporary files that processes of this machine left when they were killed.

    Args:
        folder: Folder that they wrote to.
        name: Name of the file that they were to become; of any by default.
    """
    for path in Path(folder).glob(f".{name}.{_HOST}.*.tmp"):
        pid = path.name.split(".")[-2]
        if pid.isdigit() and not _is_alive(int(pid)):
            path.unlink(missing_ok=True)


def _sync(folder: Path) -> None:
    if os.name != "posix":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _is_alive(pid: int) -> bool:
    if os.name != "posix":
        return True
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        pass
    return True
