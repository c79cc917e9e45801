"""bfloat16 on the CPU: matrix products, and the networks that encode images."""

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Literal

import torch

Precision = Literal["float32", "bfloat16"]


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
    before = torch.get_float32_matmul_precision()
    if precision == "bfloat16":
        torch.set_float32_matmul_precision("medium")
    try:
        yield
    finally:
        torch.set_float32_matmul_precision(before)


def image_precision(device: torch.device) -> AbstractContextManager[None]:
    """Context in which an encoder of images computes in the precision of the matrix products.

    On x86 torch's setting for them does not reach convolutions. Outputs of layers are rounded, too.
    """
    if device.type == "cpu" and torch.get_float32_matmul_precision() == "medium":
        return torch.autocast("cpu", torch.bfloat16)
    return nullcontext()
