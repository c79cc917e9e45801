"""Numba kernels over a batch of scenes, on several threads where that is safe."""

import os
import threading
from collections.abc import Callable
from typing import Any, Generic, TypeVar

import numba
import torch
from torch import Tensor

from modpush._kernels import njit

_threads_forbidden = False
# Held while a kernel runs on numba's threads, whose scheduler may not be entered twice at once.
_threads_in_use = threading.Lock()


def _forbid_threads() -> None:
    global _threads_forbidden
    _threads_forbidden = True


# A forked child inherits the state of the threading library but none of its threads; OpenMP aborts
# the process at the first parallel loop. Spawned workers are not concerned.
os.register_at_fork(after_in_child=_forbid_threads)


def sum_in_order(values: Tensor) -> Tensor:
    """Sum over the last dimension, from the first value to the last, `[..., N]` to `[...]`.

    Where scenes are padded to the longest of a batch, torch's own sum adds in an order that depends on
    N, and so on the other scenes. Zeros at the end do not change this one.
    """
    return values.cumsum(-1)[..., -1]


class BatchKernel:
    """A numba kernel over a batch of scenes, compiled for one thread and for several.

    The serial form runs where torch has one thread (`torch.set_num_threads(1)`), so that a process
    that shares its cores says so once for both libraries. OpenMP's threads wait for each other by
    spinning: beside a busy process two of them took 16 ms for what one did in 1 ms. It also runs
    while another Python thread runs a kernel on several threads.

    Args:
        function: `function(batch, *arguments)` with a loop `for b in prange(batch)` over the scenes.
        parallel_from: Number of scenes from which on several threads are used.
        **options: Those of `numba.njit`.
    """

    def __init__(
        self, function: Callable[..., None], parallel_from: int = 2, **options: Any
    ) -> None:
        self._parallel_from = parallel_from
        self._serial = njit(nogil=True, **options)(function)  # in which a `prange` is a `range`
        self._parallel = njit(nogil=True, parallel=True, **options)(function)

    def __call__(self, batch: int, *arguments: Any) -> None:
        """Run the kernel for all scenes."""
        # Numba is not asked how many threads it has: that alone starts them, and puts torch's number
        # back to all cores.
        threads = torch.get_num_threads()
        serial = batch < self._parallel_from or _threads_forbidden or threads == 1
        if serial or not _threads_in_use.acquire(blocking=False):
            self._serial(batch, *arguments)
            return
        try:
            numba.set_num_threads(min(threads, numba.config.NUMBA_NUM_THREADS))
            if torch.get_num_threads() != threads:
                torch.set_num_threads(threads)
            self._parallel(batch, *arguments)
        finally:
            _threads_in_use.release()


T = TypeVar("T")


class PerThread(threading.local, Generic[T]):
    """Holds one `value` per thread, None until that thread sets it.

    Compiled kernels release the interpreter's lock and write to arrays that outlast a call. With
    arrays per thread, one object may serve several threads. Copies and pickles start empty.
    """

    value: T | None = None

    def __reduce__(self) -> tuple[type, tuple[()]]:
        return type(self), ()
