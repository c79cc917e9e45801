"""The one way in which files are written and read: atomically, and sealed by a checksum.

Each file carries a seal, `<kind> v<version> sha256:<64 digits>`, at a place where its format allows
for text. The digits are the SHA-256 of the whole file with zeros in their place, so that no change
of a single bit goes unnoticed, and the file stays readable with the format's own tools.

A seal detects damage, not malice. Readers therefore bound what a file can make them allocate, and
interpret its content within `reading`, so that every file of another structure is refused by name.
"""

import gzip
import hashlib
import io
import json
import math
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
    "parse_yaml",
    "read_arrays",
    "read_json",
    "read_packed_json",
    "read_tensors",
    "read_yaml",
    "reading",
    "write_arrays",
    "write_json",
    "write_packed_json",
    "write_tensors",
    "write_text",
    "write_yaml",
]

_SEAL = re.compile(rb" v(\d{1,9}) sha256:([0-9a-f]{64})")  # after the kind
_KIND_BEFORE = re.compile(rb"[\w.]+\Z")
_LONGEST_KIND = 64
_BLANK = b"0" * 64
_MOST_TEXT = 2**26  # of a packed file [bytes]
_MOST_YAML = 2**20  # YAML takes some seconds for it [bytes]
_MOST_NODES = 100_000  # of a YAML file, each counted as often as it is referred to
_MOST_ARRAYS = 2**31  # of all arrays of a file [bytes]
_GZIP_HEAD = b"\x1f\x8b\x08\x10\0\0\0\0\x02\xff"  # deflate with a comment, no time, no system
_WRONG_STRUCTURE = (
    ArithmeticError,
    AssertionError,
    AttributeError,
    EOFError,
    LookupError,
    MemoryError,
    RuntimeError,  # RecursionError; of zipfile for an unknown compression; of torch for sizes
    TypeError,
    gzip.BadGzipFile,
)
"""Errors of code that finds another structure in a file's content than it expects."""
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
    with reading(path, kind):
        data = _mapping(json.loads(_read(path, kind, version)))
        del data["seal"]
        return data


def write_yaml(path: Path | str, data: Mapping[str, Any], kind: str, version: int) -> None:
    """Write a mapping as sealed YAML, with the seal in a comment on the first line."""
    text = f"# {_blank_seal(kind, version)}\n{dump_yaml(data)}"
    _write(path, text.encode())


def read_yaml(path: Path | str, kind: str, version: int) -> dict[str, Any]:
    """Read what `write_yaml` wrote; errors as `read_json`."""
    with reading(path, kind):
        return _mapping(parse_yaml(_read(path, kind, version)))


def parse_yaml(content: bytes | str) -> Any:
    """Plain data in YAML of moderate size; a few lines of references to references can be of any.

    Raises:
        ValueError: If it is too large, or refers to itself.
        yaml.YAMLError: If it is not YAML.
    """
    if len(content) > _MOST_YAML:
        raise ValueError(f"{len(content)} bytes of YAML, expected at most {_MOST_YAML}")
    data = load_yaml(content)
    waiting, count = [data], 0
    while waiting:
        item = waiting.pop()
        count += 1
        if count > _MOST_NODES:
            raise ValueError(f"more than {_MOST_NODES} values of YAML, or one that holds itself")
        if isinstance(item, dict):
            waiting += [*item, *item.values()]
        elif isinstance(item, list | tuple | set):
            waiting += item
    return data


def write_packed_json(path: Path | str, data: Any, kind: str, version: int) -> None:
    """Write anything that JSON can hold, compressed by gzip; the same data give the same bytes."""
    content = json.dumps(data, separators=(",", ":")).encode()
    if len(content) > _MOST_TEXT:  # which nothing would read
        raise ValueError(f"{kind}: {path} can hold {_MOST_TEXT} bytes of text, got {len(content)}.")
    deflate = zlib.compressobj(9, zlib.DEFLATED, -zlib.MAX_WBITS)
    packed = deflate.compress(content) + deflate.flush()
    end = struct.pack("<LL", zlib.crc32(content), len(content) & 0xFFFFFFFF)
    seal = _blank_seal(kind, version).encode() + b"\0"
    _write(path, _GZIP_HEAD + seal + packed + end)


def read_packed_json(path: Path | str, kind: str, version: int) -> Any:
    """Read what `write_packed_json` wrote; errors as `read_json`."""
    with reading(path, kind):
        with gzip.GzipFile(fileobj=io.BytesIO(_read(path, kind, version))) as file:
            text = file.read(_MOST_TEXT + 1)
        if len(text) > _MOST_TEXT:
            raise ValueError(f"it holds more than {_MOST_TEXT} bytes of text")
        return json.loads(text)


def write_arrays(
    path: Path | str, arrays: Mapping[str, NDArray[Any]], kind: str, version: int
) -> None:
    """Write arrays by name as a compressed `.npz`, with the seal as its comment."""
    if (size := sum(array.nbytes for array in arrays.values())) > _MOST_ARRAYS:
        raise ValueError(f"{kind}: {path} can hold {_MOST_ARRAYS} bytes of arrays, got {size}.")
    content = io.BytesIO()
    np.savez_compressed(content, **dict(arrays))  # type: ignore[arg-type]
    with zipfile.ZipFile(content, "a") as file:
        file.comment = _blank_seal(kind, version).encode()
    _write(path, content.getvalue())


def read_arrays(path: Path | str, kind: str, version: int) -> dict[str, NDArray[Any]]:
    """Read what `write_arrays` wrote; errors as `read_json`."""
    with reading(path, kind):
        content = io.BytesIO(_read(path, kind, version))
        _check_sizes(content)
        with np.load(content, allow_pickle=False) as data:
            return {name: data[name] for name in data.files}


def _check_sizes(content: io.BytesIO) -> None:
    """Refuse arrays that are larger than their file, or too large, before memory is allocated."""
    read_header = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }
    total = 0
    with zipfile.ZipFile(content) as archive:
        for member in archive.infolist():
            with archive.open(member) as array:
                shape, _, dtype = read_header[np.lib.format.read_magic(array)](array)
            size = math.prod(shape) * dtype.itemsize
            total += size
            if size > member.file_size or total > _MOST_ARRAYS:
                raise ValueError(f"{member.filename} of shape {list(shape)} is too large")
    content.seek(0)


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
    with reading(path, kind):
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
            at = found.start(2)
            digits = _digest(content, at)
        file.seek(at)
        file.write(digits)


def _check_seal(content: bytes | mmap.mmap, path: Path | str, kind: str, version: int) -> None:
    found = _SEAL.search(content)
    before = (
        b"" if found is None else content[max(0, found.start() - _LONGEST_KIND) : found.start()]
    )
    what = _KIND_BEFORE.search(before)
    if found is None or what is None:
        raise ValueError(
            f"{kind}: {path} carries no checksum: it is cut short or damaged, of an earlier version, or "
            "another kind of file."
        )
    (number, digits), at = found.groups(), found.start(2)
    if what[0].decode() != kind:
        raise ValueError(f"{kind}: {path} holds {what[0].decode()!r}, expected {kind!r}.")
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


def _mapping(data: Any) -> dict[str, Any]:
    if not isinstance(data, dict):
        raise ValueError(f"it holds a {type(data).__name__}, expected a mapping")
    return data


@contextmanager
def reading(path: Path | str, kind: str) -> Iterator[None]:
    """Turn what reading a file and interpreting its content raises into one error that names the file.

    Args:
        path: The file.
        kind: What it should hold, for the message.

    Raises:
        FileNotFoundError: If there is no such file.
        TypeError: If `path` is not a path.
        ValueError: If it is damaged, or holds something else. One that names the file already is
            passed on as it is.
    """
    if not isinstance(path, str | os.PathLike):
        raise TypeError(f"{kind}: path must be a file's path, got {path!r}.")
    if not Path(path).is_file():
        raise FileNotFoundError(f"{kind}: no file {path}.")
    try:
        yield
    except ValueError as error:
        if str(path) in str(error):
            raise
        raise ValueError(f"{kind}: {path} does not fit: {error}") from error
    except (SafetensorError, zipfile.BadZipFile, zlib.error, yaml.YAMLError, struct.error) as error:
        raise ValueError(f"{kind}: {path} is cut short or damaged ({error}).") from error
    except _WRONG_STRUCTURE as error:
        raise ValueError(f"{kind}: {path} is cut short or damaged ({error!r}).") from error


def _mapped(file: Any) -> Any:
    """A file's bytes without reading them all; an empty file cannot be mapped."""
    if os.fstat(file.fileno()).st_size == 0:
        return memoryview(b"")
    return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
