"""Worker processes, threads of torch, signals that end a run, and Ray sessions.

Signals are SIGINT (Ctrl-C), SIGTERM and SIGHUP. In another thread than the main one, where Python has
no signals, nothing is changed.
"""

import multiprocessing
import os
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from multiprocessing.connection import wait
from types import ModuleType
from typing import Any, Protocol
from urllib.parse import urlsplit

import torch

from modpush._extras import require_extra


def begin_worker_process() -> None:
    """Leave signals to the parent, and end at once when it has ended, however that was.

    SIGINT, SIGTERM and SIGHUP reach all processes of a group; the parent decides what they mean.
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
    """Set the number of threads of torch, and of the kernels that follow it, within a block.

    The batches here are too short to share out: threads that wait for each other by spinning cost more,
    all the more where another process uses the cores.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


class Interruptible(Protocol):
    """Something that ends by itself once this is set."""

    interrupted: bool


def interrupts_noted(run: Interruptible) -> AbstractContextManager[None]:
    """Within this block the first signal sets `interrupted`, and a second raises `KeyboardInterrupt`."""

    def note(*_: Any) -> None:
        if run.interrupted:
            raise KeyboardInterrupt
        run.interrupted = True
        # Not by `print`, which may be in the middle of its own work.
        os.write(2, b"\nStopping with a checkpoint; once more stops at once, without one.\n")

    return _handled_by(note)


def interrupts_raised() -> AbstractContextManager[None]:
    """Within this block each of the signals raises `KeyboardInterrupt`, as Python does for Ctrl-C."""

    def interrupt(*_: Any) -> None:
        raise KeyboardInterrupt

    return _handled_by(interrupt)


@contextmanager
def _handled_by(handler: Callable[..., None]) -> Iterator[None]:
    before = {}
    if threading.current_thread() is threading.main_thread():
        for name in ("SIGINT", "SIGTERM", "SIGHUP"):
            number = getattr(signal, name, None)  # Windows has no SIGHUP
            present = None if number is None else signal.getsignal(number)
            kept = name == "SIGHUP" and present == signal.SIG_IGN  # of a run under `nohup`
            if number is not None and present is not None and not kept:  # a handler of Python's
                before[number] = signal.signal(number, handler)
    try:
        yield
    finally:
        for number, previous in before.items():
            signal.signal(number, previous)


RESTARTS = 10
"""Number of times that Ray restarts an actor that has ended."""


@contextmanager
def ray_session(caller: str, least: int) -> Iterator[ModuleType]:
    """The package `ray`, connected to a cluster of at least `least` CPUs within a block.

    Ray looks for a cluster in `RAY_ADDRESS` and on this machine, and else starts one here. A connection
    that exists already is used and kept. Without one, or with fewer CPUs, a RuntimeError is raised.
    """
    require_extra(caller, "ray")
    import ray

    own = not ray.is_initialized()
    try:
        if own:
            _check_address(os.environ.get("RAY_ADDRESS", ""))
            ray.init(include_dashboard=False, log_to_driver=False)
        cpus = ray.cluster_resources().get("CPU", 0)
    except Exception as error:  # Ray's own kinds differ with what went wrong
        raise RuntimeError(f"{caller}: no connection to Ray: {error}") from error
    try:
        if cpus < least:
            raise RuntimeError(f"{caller}: {least} CPUs are needed, Ray has {cpus:g}.")
        yield ray
    finally:
        if own:
            ray.shutdown()


def _check_address(address: str) -> None:
    """Refuse an address at which nothing answers: `ray.init` would wait for it without end."""
    where = urlsplit(address if "://" in address else f"ray://{address}")
    if where.hostname and where.port:
        try:
            socket.create_connection((where.hostname, where.port), 5.0).close()
        except OSError as error:
            raise ConnectionError(f"nothing answers at {address} (RAY_ADDRESS), {error}") from None
