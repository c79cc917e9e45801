"""A CSV file that grows row by row, each row with a checksum of its own."""

import csv
import io
import os
import zlib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from modpush.files import reading, write_text

__all__ = ["append_row", "begin_rows", "read_rows"]

_CHECKSUM = "checksum"


def begin_rows(path: Path, columns: Sequence[str]) -> None:
    """Write the header, or drop a last row that a kill has cut off; a whole file stays untouched.

    Raises:
        ValueError: If the file has other columns.
    """
    text = path.read_bytes() if path.exists() else b""
    whole = text[: text.rfind(b"\n") + 1]
    if whole:
        _check_header(path, whole.split(b"\n")[0], columns)
    if whole != text or not whole:
        write_text(path, whole.decode() or ",".join([*columns, _CHECKSUM]) + "\n")


def append_row(path: Path, columns: Sequence[str], row: Mapping[str, Any]) -> None:
    """Add a row; it is on disk when this returns, and the file is as before where it cannot be.

    Raises:
        OSError: If the disk is full.
    """
    text = io.StringIO()
    csv.DictWriter(text, columns, lineterminator="").writerow(row)
    line = f"{text.getvalue()},{_checksum(text.getvalue().encode())}\n".encode()
    with path.open("ab", buffering=0) as file:
        before = file.seek(0, os.SEEK_END)
        try:
            if file.write(line) != len(line):
                raise OSError(f"{path}: the disk is full")
            os.fsync(file.fileno())
        except OSError:
            file.truncate(before)
            raise


def read_rows(
    path: Path, columns: Sequence[str], integers: Iterable[str] = (), texts: Iterable[str] = ()
) -> pd.DataFrame:
    """All rows, without their checksums; a last one that was cut off is left out.

    Args:
        path: The file.
        columns: Columns that it must have.
        integers: Columns that must hold whole numbers >= 0.
        texts: Columns of text, which stays text where it looks like a number or a missing value.

    Raises:
        ValueError: If the file has other columns or a row is damaged, with the number of its line.
    """
    with reading(path, "read_rows"):
        return _read_rows(path, columns, integers, texts)


def _read_rows(
    path: Path, columns: Sequence[str], integers: Iterable[str], texts: Iterable[str]
) -> pd.DataFrame:
    header, *lines = path.read_bytes().split(b"\n")[:-1] or [b""]
    _check_header(path, header, columns)
    rows = [line.rpartition(b",") for line in lines]
    for number, (row, _, checksum) in enumerate(rows, start=2):
        if checksum != _checksum(row).encode():
            raise ValueError(
                f"{path}: line {number} is damaged (its checksum differs), or was edited. "
                "Delete the line to have its episode run anew."
            )
    content = b"\n".join([",".join(columns).encode(), *(row for row, _, _ in rows), b""])
    texts = set(texts)
    table = pd.read_csv(
        io.BytesIO(content),
        dtype={name: str for name in columns if name in texts},
        keep_default_na=False,
        na_values={name: ["", "nan"] for name in columns if name not in texts},
    )
    for name in integers if len(table) else ():
        if table[name].dtype.kind != "i" or (table[name] < 0).any():
            raise ValueError(f"{path}: {name} must be whole numbers >= 0.")
    return table


def _check_header(path: Path, header: bytes, columns: Sequence[str]) -> None:
    expected = [*columns, _CHECKSUM]
    found = header.decode(errors="replace").split(",")
    if found != expected:
        raise ValueError(f"{path} must have the columns {expected}, got {found}.")


def _checksum(line: bytes) -> str:
    return f"{zlib.crc32(line):08x}"
