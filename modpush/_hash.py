"""Short hashes by which files and results tell one set of weights or data from another."""

import hashlib
import json
from typing import Any

import torch
from torch import nn

__all__ = ["data_hash", "weights_hash"]


def weights_hash(module: nn.Module) -> str:
    """The first 16 hexadecimal digits of the SHA-256 of a module's parameters and buffers."""
    digest = hashlib.sha256()
    for name, value in sorted(module.state_dict().items()):
        if hasattr(value, "numpy"):
            digest.update(f"{name} {tuple(value.shape)} {value.dtype}".encode())
            flat = value.detach().cpu().contiguous().reshape(-1)  # NumPy has no bfloat16
            digest.update(flat.view(torch.uint8).numpy().tobytes())
    return digest.hexdigest()[:16]


def data_hash(data: Any) -> str:
    """The same of anything that JSON can hold, whatever the order of its keys."""
    return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()[:16]
