"""A word when kernels are compiled, which happens once on a machine."""

import sys
from typing import Any

from numba.core import event
from tqdm import tqdm

__all__ = ["announce_compiling"]


class _Announcement(event.Listener):
    _made = False

    def on_start(self, event: Any) -> None:
        if not self._made:
            tqdm.write("Compiling kernels, once on this machine, for a minute or two.", sys.stderr)
            self._made = True

    def on_end(self, event: Any) -> None:
        pass


def announce_compiling() -> None:
    """Say so when a kernel has to be compiled, in this process or in one that it forks."""
    event.register("numba:compile", _Announcement())
