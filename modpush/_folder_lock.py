"""One process at a time may write to a folder."""

import json
import os
import socket
import time
import warnings
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import IO
from weakref import WeakSet

from modpush._atomic import make_folder

try:
    import fcntl
except ImportError:  # not on Windows, where folders are not locked
    fcntl = None  # type: ignore[assignment]

__all__ = ["FolderLock", "FolderLockedError"]

_NAME = ".lock"
_held: "WeakSet[FolderLock]" = WeakSet()


class FolderLockedError(OSError):
    """Another process writes to the folder."""


class FolderLock:
    """A folder that no other process may write to. It ends with the process, however that ends.

    On a file system without locks it warns that there is none.

    Args:
        folder: The folder; made if it is not there.

    Raises:
        FolderLockedError: If another process holds it; the message says which, where and since when.
        NotADirectoryError: If it, or a folder that it lies in, is a file.
        OSError: If the folder cannot be written to.
    """

    def __init__(self, folder: Path | str) -> None:
        self.path = Path(folder) / _NAME
        make_folder(folder)
        try:
            self._file: IO[str] | None = self.path.open("a+", encoding="utf-8")
        except OSError as error:
            reason = f"the folder cannot be written to ({error.strerror})"
            raise type(error)(error.errno, reason, str(folder)) from None
        try:
            if fcntl is not None:
                fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self._file.seek(0)
            holder = self._file.read()
            self._file.close()
            raise FolderLockedError(
                f"{folder} is in use by {_description(holder)}. Wait for it, end it, or take another "
                "folder."
            ) from None
        except OSError as error:  # NFS without lockd, some Lustre and FUSE mounts
            warnings.warn(
                f"The file system of {folder} has no locks ({error.strerror}). Nothing keeps a second "
                "process from writing to the folder: see to it that there is none.",
                stacklevel=2,
            )
        _held.add(self)
        about = {"pid": os.getpid(), "host": socket.gethostname(), "since": time.time()}
        with suppress(OSError):  # the lock holds on a full disk, too
            self._file.truncate(0)
            self._file.write(json.dumps(about))
            self._file.flush()

    def release(self) -> None:
        """Let others write to the folder."""
        if self._file is not None:
            with suppress(OSError):
                self._file.close()
            self._file = None
        _held.discard(self)

    def __enter__(self) -> "FolderLock":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.release()


def _description(holder: str) -> str:
    try:
        about = json.loads(holder)
        since = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(about["since"]))
        return f"process {about['pid']} on {about['host']} since {since}"
    except (ValueError, KeyError, TypeError):
        return "another process"


def _release_in_child() -> None:
    # A forked process shares the lock, and would hold it after its parent has ended.
    for lock in list(_held):
        lock.release()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_release_in_child)
