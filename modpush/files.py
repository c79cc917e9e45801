"""Writing files whole or not at all, and the tensor files that hold encoders and agents."""

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

__all__ = ["read_tensors", "replacing", "write_tensors", "write_text"]


@contextmanager
def replacing(path: Path | str) -> Iterator[Path]:
    """Write to a temporary file that takes the place of `path` when the block ends without an error.

    Until then, and after an error or a kill, `path` is as it was before. The new content is on disk
    before the name is.

    Args:
        path: The file to replace; its folder is made.

    Yields:
        The temporary file's path, in the same folder.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        yield unfinished
        with unfinished.open("rb+") as file:
            os.fsync(file.fileno())
        unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)


def write_text(path: Path | str, text: str) -> None:
    """Write a text file whole or not at all."""
    with replacing(path) as unfinished:
        unfinished.write_text(text)


def write_tensors(
    path: Path | str, tensors: dict[str, Tensor], kind: str, version: int, config: dict[str, Any]
) -> None:
    """Write a safetensors file with a kind, a version and a config, whole or not at all.

    Args:
        path: The file; its folder is made.
        tensors: The tensors by name.
        kind: What the file holds, `"modpush.<Class>"`.
        version: Version of this kind's layout.
        config: Anything that JSON can hold.
    """
    metadata = {"kind": kind, "version": str(version), "config": json.dumps(config)}
    with replacing(path) as unfinished:
        save_file({k: v.contiguous() for k, v in tensors.items()}, unfinished, metadata)


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
            tensors = {key: file.get_tensor(key) for key in file.keys()}
            return tensors, json.loads(metadata["config"])
    except SafetensorError as error:
        raise ValueError(f"{kind}: {path} is cut short or damaged ({error}).") from error
