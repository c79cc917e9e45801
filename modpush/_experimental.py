"""Warnings for what has never run on the hardware that it is for."""

import functools
import warnings

__all__ = ["warn_experimental"]


@functools.cache
def warn_experimental(what: str) -> None:
    """Warn, once per process and subject, that something has never been run on a GPU."""
    warnings.warn(
        f"{what} on CUDA is experimental: it has never been run. Check it with `make test-gpu` first, "
        "or use device='cpu'.",
        UserWarning,
        stacklevel=3,
    )
