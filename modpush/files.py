"""Files of data: safetensors for tensors, JSON, YAML and `.npz` for the rest, never a pickle.

Each file is written beside its name and renamed, so that it is whole or as before. Files of tensors, on
which a policy acts or a run continues, carry a checksum in their metadata,
`<kind> v<version> sha256:<64 digits>`: the SHA-256 of the whole file with zeros in place of the digits.
A checksum detects damage, not malice. Readers therefore bound what a file can make them allocate, and
interpret its content within `reading`, so that every file of another structure is refused by name.
"""

import gzip
import hashlib
import io
import json
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
import yaml
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from modpush._atomic import replacing

_SCALARS = {
    "bool": (r"true|True|TRUE|false|False|FALSE", [*"tTfF"]),
    "null": (r"~|null|Null|NULL|", ["~", "n", "N", ""]),
    "int": (r"[-+]?[0-9][0-9_]*|0o[0-7]+|0x[0-9a-fA-F]+", [*"-+0123456789"]),
    "float": (
        r"[-+]?(\.[0-9]+|[0-9][0-9_]*(\.[0-9]*)?)([eE][-+]?[0-9]+)?"
        r"|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)",
        [*"-+.0123456789"],
    ),
    "merge": ("<<", ["<"]),
}
"""Forms of scalars that are no text, and the characters that they begin with."""


class _Loader(yaml.SafeLoader):
    yaml_implicit_resolvers: dict[str, Any] = {}  # noqa: RUF012 (as PyYAML declares it)

    def construct_yaml_int(self, node: yaml.ScalarNode) -> int:
        return int(node.value, 0 if node.value[:2] in ("0o", "0x") else 10)


for _name, (_form, _first) in _SCALARS.items():
    _pattern = re.compile(f"^(?:{_form})$")
    _Loader.add_implicit_resolver(f"tag:yaml.org,2002:{_name}", _pattern, _first)
_Loader.add_constructor("tag:yaml.org,2002:int", _Loader.construct_yaml_int)


class _Dumper(yaml.SafeDumper):
    """Quotes text that the loader would take for something else."""

    yaml_implicit_resolvers = _Loader.yaml_implicit_resolvers


def load_yaml(text: str | bytes) -> Any:
    """Plain data from YAML, or a `yaml.YAMLError`."""
    return yaml.load(text, _Loader)


def dump_yaml(data: Mapping[str, Any]) -> str:
    """YAML that `load_yaml` reads as the same data."""
    return yaml.dump(dict(data), Dumper=_Dumper, sort_keys=False)


_SEAL = re.compile(rb'"([\w.]{1,64}) v(\d{1,9}) sha256:([0-9a-f]{64})"')
_BLANK = b"0" * 64
_MOST_TEXT = 2**26  # of a packed file [bytes]
_MOST_YAML = 2**20  # YAML takes some seconds for it [bytes]
_MOST_NODES = 100_000  # of a YAML file, each counted as often as it is referred to
_MOST_ARRAYS = 2**31  # of all arrays of a file [bytes]
_WRONG_STRUCTURE = (
    ArithmeticError,
    AssertionError,
    AttributeError,
    EOFError,
    LookupError,
    MemoryError,
    RuntimeError,  # RecursionError; of zipfile for an unknown compression; of torch for sizes
    SafetensorError,
    TypeError,
    gzip.BadGzipFile,
    struct.error,
    yaml.YAMLError,
    zipfile.BadZipFile,
    zlib.error,
)
"""Errors of code that finds another structure in a file's content than it expects."""


def write_text(path: Path | str, text: str) -> None:
    """Write a text file atomically, in UTF-8."""
    with replacing(path) as unfinished:
        unfinished.write_text(text, encoding="utf-8")


def write_json(path: Path | str, data: Mapping[str, Any], kind: str, version: int) -> None:
    """Write a mapping as JSON, with kind and version under the key `"format"`."""
    write_text(path, json.dumps({"format": f"{kind} v{version}", **data}, indent=1))


def read_json(path: Path | str, kind: str, version: int) -> dict[str, Any]:
    """Read what `write_json` wrote.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is damaged, of another kind or of another version.
    """
    with reading(path, kind):
        data = _mapping(json.loads(Path(path).read_bytes()))
        _check_format(data.pop("format", None), kind, version)
        return data


def write_yaml(path: Path | str, data: Mapping[str, Any], kind: str, version: int) -> None:
    """Write a mapping as YAML, with kind and version in a comment on the first line."""
    write_text(path, f"# {kind} v{version}\n{dump_yaml(data)}")


def read_yaml(path: Path | str, kind: str) -> dict[str, Any]:
    """Read a mapping from YAML; errors as `read_json`."""
    with reading(path, kind):
        return _mapping(parse_yaml(Path(path).read_bytes()))


def parse_yaml(content: bytes | str) -> Any:
    """Plain data in YAML of moderate size; a few lines of references to references can be of any."""
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


def write_packed_json(path: Path | str, data: Any) -> None:
    """Write anything that JSON can hold, compressed by gzip; the same data give the same bytes."""
    content = json.dumps(data, separators=(",", ":")).encode()
    with replacing(path) as unfinished:
        unfinished.write_bytes(gzip.compress(content, mtime=0))


def read_packed_json(path: Path | str, kind: str) -> Any:
    """Read what `write_packed_json` wrote; errors as `read_json`."""
    with reading(path, kind):
        with gzip.open(path) as file:
            text = file.read(_MOST_TEXT + 1)
        if len(text) > _MOST_TEXT:
            raise ValueError(f"it holds more than {_MOST_TEXT} bytes of text")
        return json.loads(text)


def write_arrays(path: Path | str, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write arrays by name as a compressed `.npz`."""
    content = io.BytesIO()
    np.savez_compressed(content, **dict(arrays))  # type: ignore[arg-type]
    with replacing(path) as unfinished:
        unfinished.write_bytes(content.getvalue())


def read_arrays(path: Path | str, kind: str) -> dict[str, NDArray[Any]]:
    """Read what `write_arrays` wrote; errors as `read_json`."""
    with reading(path, kind):
        with zipfile.ZipFile(path) as archive:
            size = sum(member.file_size for member in archive.infolist())
        if size > _MOST_ARRAYS:
            raise ValueError(f"it holds {size} bytes of arrays, expected at most {_MOST_ARRAYS}")
        with np.load(path, allow_pickle=False) as data:
            return {name: data[name] for name in data.files}


def write_tensors(
    path: Path | str, tensors: Mapping[str, Tensor], kind: str, version: int, config: Any
) -> None:
    """Write a safetensors file with a checksum, and a config that is ready for JSON, atomically.

    `kind` is the class of what the file holds, `"modpush.<Class>"`, and `version` that of its layout.

    Raises:
        OSError: If it cannot be written; what was there before stays.
    """
    own, memory = {}, set()
    for name, value in tensors.items():
        own[name] = value.detach().cpu().contiguous()
        if (start := own[name].untyped_storage().data_ptr()) in memory:
            own[name] = own[name].clone()  # safetensors refuses tensors that share memory
        memory.add(start)
    seal = f"{kind} v{version} sha256:{_BLANK.decode()}"
    with replacing(path) as unfinished:
        try:
            save_file(own, unfinished, {"seal": seal, "config": json.dumps(config)})
        except SafetensorError as error:
            raise OSError(str(error)) from error
        content = unfinished.read_bytes()
        found = _SEAL.search(content)
        assert found is not None
        with unfinished.open("rb+") as file:
            file.seek(found.start(3))
            file.write(hashlib.sha256(content).hexdigest().encode())


def read_tensors(path: Path | str, kind: str, version: int) -> tuple[dict[str, Tensor], Any]:
    """Read what `write_tensors` wrote: tensors and config; errors as `read_json`."""
    with reading(path, kind):
        content = Path(path).read_bytes()
        found = _SEAL.search(content)
        if found is None:
            raise ValueError(
                "it carries no checksum: it is cut short, damaged or another kind of file"
            )
        _check_format(f"{found[1].decode()} v{int(found[2])}", kind, version)
        digest = hashlib.sha256(content[: found.start(3)])
        digest.update(_BLANK)
        digest.update(memoryview(content)[found.end(3) :])
        if digest.hexdigest().encode() != found[3]:
            raise ValueError("it is cut short or damaged, or was edited: its checksum differs")
        with safe_open(path, framework="pt") as tensors:
            values = {key: tensors.get_tensor(key) for key in tensors.keys()}
            return values, json.loads(tensors.metadata()["config"])


def _check_format(found: Any, kind: str, version: int) -> None:
    if found != f"{kind} v{version}":
        raise ValueError(f"it must be of the format '{kind} v{version}', got {found!r}")


def _mapping(data: Any) -> dict[str, Any]:
    if not isinstance(data, dict):
        raise ValueError(f"it holds a {type(data).__name__}, expected a mapping")
    return data


@contextmanager
def reading(path: Path | str, kind: str) -> Iterator[None]:
    """Turn what reading a file and interpreting its content raises into one error that names the file.

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
        raise ValueError(f"{kind}: {path} cannot be read: {str(error).rstrip('.')}.") from error
    except _WRONG_STRUCTURE as error:
        raise ValueError(
            f"{kind}: {path} is damaged or of another structure ({error!r})."
        ) from error
