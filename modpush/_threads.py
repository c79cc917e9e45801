"""Number of torch's threads within a block."""

from collections.abc import Iterator
from contextlib import contextmanager

import torch

__all__ = ["torch_threads"]


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
