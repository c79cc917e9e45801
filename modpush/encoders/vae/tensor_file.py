"""safetensors files with a kind, a version and a config, written whole or not at all."""

import json
import os
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

__all__ = ["read_tensors", "write_tensors"]


def write_tensors(
    path: Path | str, tensors: dict[str, Tensor], kind: str, version: int, config: dict[str, Any]
) -> None:
    """Write a file under another name, then put it in place, so that no half of it is ever there.

    Args:
        path: The file; its folder is made.
        tensors: By name.
        kind: What it is, `"modpush.<Class>"`.
        version: Of that kind's layout.
        config: Anything that JSON can hold.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(f"{path.name}.{os.getpid()}.tmp")
    metadata = {"kind": kind, "version": str(version), "config": json.dumps(config)}
    try:
        save_file({k: v.contiguous() for k, v in tensors.items()}, unfinished, metadata)
        os.replace(unfinished, path)
    finally:
        unfinished.unlink(missing_ok=True)


def read_tensors(
    path: Path | str, kind: str, version: int
) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Read what `write_tensors` wrote: tensors and config.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is cut short, of another kind or of another version.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{kind}: no file {path}.")
    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            if metadata.get("kind") != kind:
                raise ValueError(
                    f"{kind}: {path} holds {metadata.get('kind', 'something else')!r}, "
                    f"expected {kind!r}."
                )
            if metadata.get("version") != str(version):
                raise ValueError(
                    f"{kind}: {path} is of version {metadata.get('version')}, expected {version}."
                )
            return {key: file.get_tensor(key) for key in file.keys()}, json.loads(
                metadata["config"]
            )
    except SafetensorError as error:
        raise ValueError(f"{kind}: {path} is cut short or damaged ({error}).") from error
