"""Nested states in files, without a pickle, and checks and hashes of weights."""

import hashlib
import json
from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor, nn

from modpush.files import read_tensors, reading, write_tensors


def write_state(path: Path | str, state: Any, kind: str, version: int) -> None:
    """Write a nested state as one safetensors file, atomically.

    The state consists of dictionaries, lists, tuples, tensordicts, tensors, arrays, devices, sizes and
    what JSON can hold; a TypeError says where it holds something else.
    """
    tensors: dict[str, Tensor] = {}
    outline = _outline(state, tensors, "state")
    write_tensors(path, tensors, kind, version, outline)


def read_state(path: Path | str, kind: str, version: int) -> Any:
    """Read what `write_state` wrote; errors as `modpush.files.read_json`.

    Tensors are mapped from the file: copy what is to be kept.
    """
    with reading(path, kind):
        tensors, outline = read_tensors(path, kind, version)
        return _rebuilt(outline, tensors)


class SavedState(ABC):
    """`dumps` and `loads` of a folder, as TorchRL's samplers have them, by the `state_dict`."""

    state_file: ClassVar[str]
    """Name of the file in the folder."""

    @abstractmethod
    def state_dict(self) -> dict[str, Any]:
        """The state as plain data and tensors."""

    @abstractmethod
    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Continue with a state."""

    def dumps(self, path: str | Path) -> None:
        """Write the state into a directory."""
        kind = f"modpush.{type(self).__name__}"
        write_state(Path(path) / self.state_file, self.state_dict(), kind, 1)

    def loads(self, path: str | Path) -> None:
        """Read the state from a directory.

        Raises:
            FileNotFoundError: If nothing of the kind was saved there.
            ValueError: If the file is damaged.
        """
        file, kind = Path(path) / self.state_file, f"modpush.{type(self).__name__}"
        with reading(file, kind):
            self.load_state_dict(read_state(file, kind, 1))


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
