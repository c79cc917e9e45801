"""Signals that end a training run in order: SIGINT (Ctrl-C), SIGTERM and SIGHUP.

In another thread than the main one, where Python has no signals, nothing is changed.
"""

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Any, Protocol

__all__ = ["interrupts_noted", "interrupts_raised"]


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
