"""`njit`: numba's decorator, with a cache on disk whose loss costs time and never the result.

Numba's own cache ends the import where there is no folder to write to, ends the call where a file is
damaged or the disk is full, ignores kernels beside a package that is only read, and returns outdated
ones where a kernel in another file or a constant has changed.
"""

import hashlib
import inspect
import os
import pickle
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, Generic, TypeVar

import numba
import numpy as np
import torch
from numba.core.caching import CompileResultCacheImpl, FunctionCache, InTreeCacheLocator
from numba.core.dispatcher import Dispatcher
from numba.core.serialize import dumps
from torch import Tensor
from tqdm import tqdm


def njit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """`numba.njit` with a cache on disk; the options are its own, except for `cache`."""

    def compiled(function: Callable[..., Any]) -> Any:
        kernel: Any = numba.njit(**options)(function)
        if not numba.config.DISABLE_JIT:
            with suppress(Exception):  # the source is no file
                cache = _Cache(function, options.get("parallel", False))
                setattr(kernel, "_cache", cache)  # noqa: B010  # numba types it away
        return kernel

    return compiled


@cache
def _announce_compiling() -> None:
    tqdm.write("Compiling kernels, once on this machine, for a minute or two.", sys.stderr)


class _BesideSource(InTreeCacheLocator):
    """The folder beside the source, also where it cannot be written to."""

    def ensure_cache_path(self) -> None:
        pass


class _CacheImpl(CompileResultCacheImpl):
    _locator_classes = (*CompileResultCacheImpl._locator_classes, _BesideSource)


class _Cache(FunctionCache):
    """One file per signature: a checksum of it and of all that it was compiled from, and the kernel."""

    _impl_class = _CacheImpl

    def __init__(self, function: Callable[..., Any], parallel: bool) -> None:
        super().__init__(function)
        self._parallel = parallel

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        target_context.refresh()
        beside = Path(inspect.getfile(self._py_func)).parent / "__pycache__"
        for folder in dict.fromkeys([Path(self.cache_path), beside]):
            with suppress(Exception):  # a damaged file can raise anything
                content = self._file(folder, sig, target_context.codegen()).read_bytes()
                seal, kernel = content[:32], content[32:]
                if seal == self._seal(sig, target_context.codegen(), kernel):
                    return self._impl.rebuild(target_context, pickle.loads(kernel))
        _announce_compiling()  # which numba does next
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        if not self._impl.check_cachable(data):
            return
        kernel = dumps(self._impl.reduce(data))
        with suppress(Exception):
            self._impl.locator.ensure_cache_path()
            path = self._file(Path(self.cache_path), sig, data.codegen)
            with self._cache_file._open_for_write(path) as file:
                file.write(self._seal(sig, data.codegen, kernel) + kernel)

    def flush(self) -> None:
        """Do nothing: an outdated file is not read."""

    def _file(self, folder: Path, sig: Any, codegen: Any) -> Path:
        name = hashlib.sha256(self._key(sig, codegen)).hexdigest()[:16]
        return folder / f"{self._impl.filename_base}.{name}.kernel"

    def _seal(self, sig: Any, codegen: Any, kernel: bytes) -> bytes:
        origin = self._key(sig, codegen) + _origin(self._py_func.__module__)
        return hashlib.sha256(origin + kernel).digest()

    def _key(self, sig: Any, codegen: Any) -> bytes:
        how = (numba.__version__, numba.config.BOUNDSCHECK, self._parallel)
        return repr((*how, self._index_key(sig, codegen))).encode()


@cache
def _origin(module: str) -> bytes:
    """Checksum of what the kernels of a module are compiled from: sources and constants."""
    names = vars(sys.modules[module])
    origin = hashlib.sha256(Path(names["__file__"]).read_bytes())
    for name, value in sorted(names.items()):
        if isinstance(value, (int, float, tuple, np.generic, np.ndarray)):
            origin.update(f"{name}={value!r}".encode())
        elif isinstance(value, Dispatcher) and value.py_func.__module__ != module:
            origin.update(_origin(value.py_func.__module__))
    return origin.digest()


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
