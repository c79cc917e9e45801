"""Worker processes end with the process that started them."""

import multiprocessing
import os
import signal
import threading
from multiprocessing.connection import wait

__all__ = ["begin_worker_process", "end_with_parent"]


def begin_worker_process() -> None:
    """Leave signals to the parent, and end at once when it has ended, however that was.

    Ctrl-C, a closed terminal and a polite kill reach all processes of a group; the parent decides
    what they mean.
    """
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    end_with_parent()


def end_with_parent() -> None:
    """End at once when the parent has ended, however that was; signals are left as they are."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_watch, args=(parent.sentinel,), daemon=True).start()


def _watch(sentinel: int) -> None:
    wait([sentinel])
    os._exit(1)
