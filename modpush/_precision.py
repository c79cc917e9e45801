"""bfloat16 on the CPU: matrix products, and the networks that encode images."""

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from typing import Literal

import torch

Precision = Literal["float32", "bfloat16"]
_reduced = ContextVar("bfloat16", default=False)


def processor_precision() -> Precision:
    """Precision whose matrix products are faster here: bfloat16 with AMX or AVX512-BF16."""
    capabilities = torch.cpu.get_capabilities()
    fast = capabilities.get("amx_bf16") or capabilities.get("avx512_bf16")
    return "bfloat16" if fast else "float32"


@contextmanager
def matrix_products(precision: Precision) -> Iterator[None]:
    """Context in which matrix products on the CPU round their factors to bfloat16 and sum in float32.

    It is torch's setting for the whole process, which is as it was afterwards; "float32" leaves it alone.
    """
    if precision == "float32":
        yield
        return
    before = torch.get_float32_matmul_precision()
    token = _reduced.set(True)
    torch.set_float32_matmul_precision("medium")
    try:
        yield
    finally:
        torch.set_float32_matmul_precision(before)
        _reduced.reset(token)


def image_precision(device: torch.device) -> AbstractContextManager[None]:
    """Context for an encoder of images: `torch.autocast` to bfloat16 where matrix products are in it.

    That is within `matrix_products("bfloat16")` on the CPU, and nothing elsewhere. torch's setting for
    products does not reach convolutions on x86.
    """
    if device.type == "cpu" and _reduced.get():
        return torch.autocast("cpu", torch.bfloat16)
    return nullcontext()
