"""Worker processes that end with their parent, and the number of torch's threads in a process."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.connection import wait

import torch

__all__ = ["begin_worker_process", "torch_threads"]


def begin_worker_process() -> None:
    """Leave signals to the parent, and end at once when it has ended, however that was.

    Ctrl-C, a closed terminal and a polite kill reach all processes of a group; the parent decides
    what they mean.
    """
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_after, args=(parent.sentinel,), daemon=True).start()


def _end_after(sentinel: int) -> None:
    wait([sentinel])
    os._exit(1)


@contextmanager
def torch_threads(count: int) -> Iterator[None]:
    """Have torch, and the kernels that follow it, use so many threads within a block.

    The batches here are too short to share out: threads that wait for each other by spinning cost more,
    all the more where another process uses the cores.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)
