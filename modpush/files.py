"""The one way in which files are written and read: atomically, and sealed by a checksum.

Each file carries a seal, `<kind> v<version> sha256:<64 digits>`, at a place where its format allows
for text. The digits are the SHA-256 of the whole file with zeros in their place, so that no change
of a single bit goes unnoticed, and the file stays readable with the format's own tools.
"""

import gzip
import hashlib
import io
import json
import mmap
import os
import re
import struct
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch
import yaml
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from torch import Tensor

from modpush._atomic import replacing
from modpush._yaml import dump_yaml, load_yaml

__all__ = [
    "read_arrays",
    "read_json",
    "read_packed_json",
    "read_tensors",
    "read_yaml",
    "write_arrays",
    "write_json",
    "write_packed_json",
    "write_tensors",
    "write_text",
    "write_yaml",
]

_SEAL = re.compile(rb"([\w.]+) v(\d+) sha256:([0-9a-f]{64})")
_BLANK = b"0" * 64
_GZIP_HEAD = b"\x1f\x8b\x08\x10\0\0\0\0\x02\xff"  # deflate with a comment, no time, no system
_DTYPES = {
    torch.float64: "F64",
    torch.int64: "I64",
    torch.float32: "F32",
    torch.int32: "I32",
    torch.bfloat16: "BF16",
    torch.float16: "F16",
    torch.int16: "I16",
    torch.uint8: "U8",
    torch.int8: "I8",
    torch.bool: "BOOL",
}
"""Names of the dtypes in safetensors files, the largest first, which keeps all tensors aligned."""


def write_text(path: Path | str, text: str) -> None:
    """Write a text file without a seal, atomically."""
    with replacing(path) as unfinished:
        unfinished.write_text(text, encoding="utf-8")


def write_json(path: Path | str, data: Mapping[str, Any], kind: str, version: int) -> None:
    """Write a mapping as sealed JSON, with the seal under the key `"seal"`."""
    sealed = {"seal": _blank_seal(kind, version), **data}
    _write(path, json.dumps(sealed, indent=1).encode())


def read_json(path: Path | str, kind: str, version: int) -> dict[str, Any]:
    """Read what `write_json` wrote.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is damaged, of another kind or of another version.
    """
    with _explained(path, kind):
        data: dict[str, Any] = json.loads(_read(path, kind, version))
        del data["seal"]
        return data


def write_yaml(path: Path | str, data: Mapping[str, Any], kind: str, version: int) -> None:
    """Write a mapping as sealed YAML, with the seal in a comment on the first line."""
    text = f"# {_blank_seal(kind, version)}\n{dump_yaml(data)}"
    _write(path, text.encode())


def read_yaml(path: Path | str, kind: str, version: int) -> dict[str, Any]:
    """Read what `write_yaml` wrote; errors as `read_json`."""
    with _explained(path, kind):
        data: dict[str, Any] = load_yaml(_read(path, kind, version))
        return data


def write_packed_json(path: Path | str, data: Any, kind: str, version: int) -> None:
    """Write anything that JSON can hold, compressed by gzip; the same data give the same bytes."""
    content = json.dumps(data, separators=(",", ":")).encode()
    deflate = zlib.compressobj(9, zlib.DEFLATED, -zlib.MAX_WBITS)
    packed = deflate.compress(content) + deflate.flush()
    end = struct.pack("<LL", zlib.crc32(content), len(content) & 0xFFFFFFFF)
    seal = _blank_seal(kind, version).encode() + b"\0"
    _write(path, _GZIP_HEAD + seal + packed + end)


def read_packed_json(path: Path | str, kind: str, version: int) -> Any:
    """Read what `write_packed_json` wrote; errors as `read_json`."""
    with _explained(path, kind):
        return json.loads(gzip.decompress(_read(path, kind, version)))


def write_arrays(
    path: Path | str, arrays: Mapping[str, NDArray[Any]], kind: str, version: int
) -> None:
    """Write arrays by name as a compressed `.npz`, with the seal as its comment."""
    content = io.BytesIO()
    np.savez_compressed(content, **dict(arrays))  # type: ignore[arg-type]
    with zipfile.ZipFile(content, "a") as file:
        file.comment = _blank_seal(kind, version).encode()
    _write(path, content.getvalue())


def read_arrays(path: Path | str, kind: str, version: int) -> dict[str, NDArray[Any]]:
    """Read what `write_arrays` wrote; errors as `read_json`."""
    with (
        _explained(path, kind),
        np.load(io.BytesIO(_read(path, kind, version)), allow_pickle=False) as data,
    ):
        return {name: data[name] for name in data.files}


def write_tensors(
    path: Path | str, tensors: Mapping[str, Tensor], kind: str, version: int, config: Any
) -> None:
    """Write a safetensors file with a config, atomically.

    Unlike `safetensors.torch.save_file` it copies no tensor of the CPU's memory, and reports a full
    disk as an `OSError`.

    Args:
        path: The file; its folder is made.
        tensors: The tensors by name.
        kind: What the file holds, `"modpush.<Class>"`.
        version: Version of this kind's layout.
        config: Anything that JSON can hold.
    """
    order = sorted(tensors, key=lambda name: (list(_DTYPES).index(tensors[name].dtype), name))
    about = {"seal": _blank_seal(kind, version), "config": json.dumps(config)}
    header: dict[str, Any] = {"__metadata__": about}
    end = 0
    for name in order:
        start, end = end, end + tensors[name].nbytes
        shape, dtype = list(tensors[name].shape), _DTYPES[tensors[name].dtype]
        header[name] = {"dtype": dtype, "shape": shape, "data_offsets": [start, end]}
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)
    with replacing(path) as unfinished:
        with unfinished.open("wb") as file:
            file.write(struct.pack("<Q", len(text)) + text)
            for name in order:
                flat = tensors[name].detach().cpu().contiguous().reshape(-1)
                file.write(flat.view(torch.uint8).numpy().data)
        _seal(unfinished)


def read_tensors(path: Path | str, kind: str, version: int) -> tuple[dict[str, Tensor], Any]:
    """Read what `write_tensors` wrote: tensors and config; errors as `read_json`."""
    with _explained(path, kind):
        with Path(path).open("rb") as file, _mapped(file) as content:
            _check_seal(content, path, kind, version)
        with safe_open(path, framework="pt") as tensors:
            found = {key: tensors.get_tensor(key) for key in tensors.keys()}
            return found, json.loads(tensors.metadata()["config"])


def _blank_seal(kind: str, version: int) -> str:
    return f"{kind} v{version} sha256:{_BLANK.decode()}"


def _digest(content: bytes | mmap.mmap, at: int) -> bytes:
    """SHA-256 of all bytes with zeros in the place of the 64 digits at `at`."""
    with memoryview(content) as view:
        digest = hashlib.sha256(view[:at])
        digest.update(_BLANK)
        digest.update(view[at + len(_BLANK) :])
    return digest.hexdigest().encode()


def _seal(path: Path) -> None:
    """Put the digits into the blank seal of a file."""
    with path.open("rb+") as file:
        with _mapped(file) as content:
            found = _SEAL.search(content)
            assert found is not None
            at = found.start(3)
            digits = _digest(content, at)
        file.seek(at)
        file.write(digits)


def _check_seal(content: bytes | mmap.mmap, path: Path | str, kind: str, version: int) -> None:
    found = _SEAL.search(content)
    if found is None:
        raise ValueError(
            f"{kind}: {path} carries no checksum: it is cut short or damaged, of an earlier version, or "
            "another kind of file."
        )
    (what, number, digits), at = found.groups(), found.start(3)
    if what.decode() != kind:
        raise ValueError(f"{kind}: {path} holds {what.decode()!r}, expected {kind!r}.")
    if int(number) != version:
        raise ValueError(f"{kind}: {path} is of version {int(number)}, expected {version}.")
    if _digest(content, at) != digits:
        raise ValueError(
            f"{kind}: {path} is cut short or damaged (its checksum differs), or was edited."
        )


def _write(path: Path | str, content: bytes) -> None:
    with replacing(path) as unfinished:
        unfinished.write_bytes(content)
        _seal(unfinished)


def _read(path: Path | str, kind: str, version: int) -> bytes:
    content = Path(path).read_bytes()
    _check_seal(content, path, kind, version)
    return content


@contextmanager
def _explained(path: Path | str, kind: str) -> Iterator[None]:
    """Turn what a file's reader raises into one kind of error that names the file."""
    if not isinstance(path, str | os.PathLike):
        raise TypeError(f"{kind}: path must be a file's path, got {path!r}.")
    if not Path(path).is_file():
        raise FileNotFoundError(f"{kind}: no file {path}.")
    try:
        yield
    except (SafetensorError, zipfile.BadZipFile, zlib.error, yaml.YAMLError, struct.error) as error:
        raise ValueError(f"{kind}: {path} is cut short or damaged ({error}).") from error
    except (EOFError, KeyError, TypeError, gzip.BadGzipFile, json.JSONDecodeError) as error:
        raise ValueError(f"{kind}: {path} is cut short or damaged ({error!r}).") from error


def _mapped(file: Any) -> Any:
    """A file's bytes without reading them all; an empty file cannot be mapped."""
    if os.fstat(file.fileno()).st_size == 0:
        return memoryview(b"")
    return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
