"""Nested states, such as `state_dict`s, in a file: tensors and plain data, never a pickle."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from modpush.files import read_tensors, reading, write_tensors

__all__ = ["read_state", "write_state"]


def write_state(path: Path | str, state: Any, kind: str, version: int) -> None:
    """Write a nested state as one safetensors file, atomically.

    The state consists of dictionaries, lists, tuples, tensordicts, tensors, arrays, devices, sizes and
    what JSON can hold.

    Raises:
        TypeError: If it holds something else; the message says where.
        OSError: If it cannot be written.
    """
    tensors: dict[str, Tensor] = {}
    outline = _outline(state, tensors, "state")
    write_tensors(path, tensors, kind, version, outline)


def read_state(path: Path | str, kind: str, version: int) -> Any:
    """Read what `write_state` wrote.

    Tensors are mapped from the file: copy what is to be kept.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is damaged, of another kind or of another version.
    """
    with reading(path, kind):
        tensors, outline = read_tensors(path, kind, version)
        return _rebuilt(outline, tensors)


def _outline(value: Any, tensors: dict[str, Tensor], place: str) -> Any:
    """The state as JSON, with the names of its tensors in their places."""
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, Tensor):
        tensors[name := str(len(tensors))] = value
        return {"tensor": name}
    if isinstance(value, np.ndarray):
        tensors[name := str(len(tensors))] = torch.from_numpy(value)
        return {"array": name}
    if isinstance(value, torch.Size):
        return {"size": list(value)}
    if isinstance(value, torch.device):
        return {"device": str(value)}
    if isinstance(value, TensorDictBase):
        items = _outline(value.to_dict(), tensors, place)
        return {"tensordict": items, "batch_size": list(value.batch_size)}
    if isinstance(value, Mapping):
        items = value.items()
        return {
            "dict": [
                [_outline(key, tensors, place), _outline(item, tensors, f"{place}[{key!r}]")]
                for key, item in items
            ]
        }
    if isinstance(value, list | tuple):
        items = [_outline(item, tensors, f"{place}[{i}]") for i, item in enumerate(value)]
        return {"list" if isinstance(value, list) else "tuple": items}
    raise TypeError(f"write_state: {place} is a {type(value).__name__}, which no file can hold.")


def _rebuilt(outline: Any, tensors: Mapping[str, Tensor]) -> Any:
    """Inverse of `_outline`."""
    if not isinstance(outline, dict):
        return outline
    ((what, content), *rest) = outline.items()
    if what == "tensor":
        return tensors[content]
    if what == "array":
        return tensors[content].numpy().copy()
    if what == "size":
        return torch.Size(content)
    if what == "device":
        return torch.device(content)
    if what == "tensordict":
        return TensorDict(_rebuilt(content, tensors), batch_size=rest[0][1])
    if what == "dict":
        return {_rebuilt(key, tensors): _rebuilt(item, tensors) for key, item in content}
    items = [_rebuilt(item, tensors) for item in content]
    return items if what == "list" else tuple(items)
