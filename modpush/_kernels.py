"""`njit`: numba's decorator, with a cache on disk whose loss costs time and never the result.

Numba's own cache ends the import where there is no folder to write to, ends the call where a file is
damaged or the disk is full, ignores kernels beside a package that is only read, and returns outdated
ones where a kernel in another file or a constant has changed.
"""

import hashlib
import inspect
import pickle
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba.core import event
from numba.core.caching import CompileResultCacheImpl, FunctionCache, InTreeCacheLocator
from numba.core.dispatcher import Dispatcher
from numba.core.serialize import dumps
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


class _CompilingAnnouncement(event.Listener):
    _made = False

    def on_start(self, event: Any) -> None:
        if not self._made:
            tqdm.write("Compiling kernels, once on this machine, for about a minute.", sys.stderr)
            self._made = True

    def on_end(self, event: Any) -> None:
        pass


@cache
def announce_compiling() -> None:
    """Say so on the terminal when a kernel has to be compiled, in this process or one that it forks."""
    event.register("numba:compile", _CompilingAnnouncement())


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
