"""Weights from files: checks before a network takes them over, and hashes that tell them apart."""

import hashlib
import json
from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor, nn

__all__ = ["check_weights", "data_hash", "weights_hash"]


def check_weights(source: object, own: Mapping[str, Tensor], given: Mapping[str, Tensor]) -> None:
    """Refuse weights that a network with the `state_dict` `own` cannot take over as they are.

    Raises:
        ValueError: If a weight is missing, unknown, of another shape or dtype, or not finite.
    """
    own = {name: value for name, value in own.items() if isinstance(value, Tensor)}
    missing, unknown = sorted(set(own) - set(given)), sorted(set(given) - set(own))
    if missing or unknown:
        raise ValueError(f"{source}: weights missing {missing}, unknown {unknown}.")
    for name, value in own.items():
        found = given[name]
        if found.shape != value.shape:
            raise ValueError(
                f"{source}: weights of another architecture: {name} must be {list(value.shape)}, "
                f"got {list(found.shape)}."
            )
        if found.dtype != value.dtype:
            raise ValueError(f"{source}: {name} must be {value.dtype}, got {found.dtype}.")
        if not found.isfinite().all():
            count = int((~found.isfinite()).sum())
            raise ValueError(
                f"{source}: {name} must be finite, {count} values are NaN or infinite."
            )


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
