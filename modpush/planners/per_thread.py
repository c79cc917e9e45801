"""Values per thread."""

import threading
from typing import Generic, TypeVar

__all__ = ["PerThread"]

T = TypeVar("T")


class PerThread(threading.local, Generic[T]):
    """Holds one `value` per thread, None until that thread sets it.

    Compiled kernels release the interpreter's lock and write to arrays that outlast a call. With
    arrays per thread, one object may serve several threads. Copies and pickles start empty.
    """

    value: T | None = None

    def __reduce__(self) -> tuple[type, tuple[()]]:
        return type(self), ()
