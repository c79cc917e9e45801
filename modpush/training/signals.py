"""Signals that end a training run in order."""

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Protocol

__all__ = ["interrupts_noted", "interrupts_raised"]

_SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP")


class Interruptible(Protocol):
    """Something that ends by itself once this is set."""

    interrupted: bool


@contextmanager
def interrupts_noted(run: Interruptible) -> Iterator[None]:
    """Within this block the first signal sets `interrupted`, and a second raises `KeyboardInterrupt`.

    In another thread than the main one, where Python has no signals, nothing is changed.
    """

    def note(*_: Any) -> None:
        if run.interrupted:
            raise KeyboardInterrupt
        run.interrupted = True
        # Not by `print`, which may be in the middle of its own work.
        os.write(2, b"\nStopping with a checkpoint; once more stops at once, without one.\n")

    with _handled_by(note):
        yield


@contextmanager
def interrupts_raised() -> Iterator[None]:
    """Within this block each of the signals raises `KeyboardInterrupt`, as Python does for Ctrl-C.

    In another thread than the main one, where Python has no signals, nothing is changed.
    """

    def interrupt(*_: Any) -> None:
        raise KeyboardInterrupt

    with _handled_by(interrupt):
        yield


@contextmanager
def _handled_by(handler: Callable[..., None]) -> Iterator[None]:
    before = {}
    if threading.current_thread() is threading.main_thread():
        for name in _SIGNALS:
            number = getattr(signal, name, None)
            if number is None or _is_ignored_for_good(number):
                continue
            before[number] = signal.signal(number, handler)
    try:
        yield
    finally:
        for number, previous in before.items():
            signal.signal(number, previous)


def _is_ignored_for_good(number: int) -> bool:
    """True if `nohup` lets the process outlive its terminal, or the handler is not one of Python's."""
    present = signal.getsignal(number)
    hang_up = getattr(signal, "SIGHUP", None)
    return present is None or (number == hang_up and present == signal.SIG_IGN)
