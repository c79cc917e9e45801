"""bfloat16 on the CPU, for the networks of an agent."""

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Literal

import torch

Precision = Literal["float32", "bfloat16"]
_reduced = False  # a plain value, which `torch.compile` can follow


def processor_precision() -> Precision:
    """Precision in which networks are faster here: bfloat16 with AMX or AVX512-BF16."""
    capabilities = torch.cpu.get_capabilities()
    fast = capabilities.get("amx_bf16") or capabilities.get("avx512_bf16")
    return "bfloat16" if fast else "float32"


@contextmanager
def networks_in(precision: Precision, *, fixed_weights: bool = False) -> Iterator[None]:
    """Context in which the library's networks compute in a precision on the CPU, see `autocast`.

    It holds for all threads of the process. With `fixed_weights` each weight is cast once for the whole
    context, and none may change within it.
    """
    global _reduced
    before, _reduced = _reduced, precision == "bfloat16"
    keeping: AbstractContextManager[None] = nullcontext()
    if fixed_weights and _reduced:  # torch keeps casts until its outermost autocast ends
        keeping = torch.autocast("cpu", torch.bfloat16, enabled=False)
    try:
        with keeping:
            yield
    finally:
        _reduced = before


def autocast(device: torch.device) -> AbstractContextManager[None]:
    """Context for the layers of one network: `torch.autocast` within `networks_in("bfloat16")`.

    Losses, geometry and all that is not a network stay as they are. Nothing changes on other devices.
    """
    if device.type == "cpu" and _reduced:
        return torch.autocast("cpu", torch.bfloat16)
    return nullcontext()
