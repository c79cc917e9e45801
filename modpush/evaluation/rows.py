"""A CSV file that grows row by row."""

import csv
import io
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from modpush.files import reading, write_text

__all__ = ["append_row", "begin_rows", "read_rows"]


def begin_rows(path: Path, columns: Sequence[str]) -> None:
    """Write the header, or drop a last row that a kill has cut off.

    Raises:
        ValueError: If the file has other columns.
    """
    text = path.read_text(encoding="utf-8") if path.exists() else ""
    whole = text[: text.rfind("\n") + 1]
    if whole:
        _check_header(path, whole, columns)
    if whole != text or not whole:
        write_text(path, whole or ",".join(columns) + "\n")


def append_row(path: Path, columns: Sequence[str], row: Mapping[str, Any]) -> None:
    """Add a row; it is on disk when this returns.

    Raises:
        OSError: If it cannot be written; `begin_rows` drops what was written of it.
    """
    with path.open("a", encoding="utf-8", newline="") as file:
        csv.DictWriter(file, columns, lineterminator="\n").writerow(row)
        file.flush()
        os.fsync(file.fileno())


def read_rows(
    path: Path, columns: Sequence[str], integers: Iterable[str] = (), texts: Iterable[str] = ()
) -> pd.DataFrame:
    """All rows; a last one that was cut off is left out.

    Args:
        path: The file.
        columns: Columns that it must have.
        integers: Columns that must hold whole numbers >= 0.
        texts: Columns of text, which stays text where it looks like a number or a missing value.

    Raises:
        ValueError: If the file has other columns, or an integer is none.
    """
    with reading(path, "read_rows"):
        text = path.read_text(encoding="utf-8")
        whole = text[: text.rfind("\n") + 1]
        _check_header(path, whole, columns)
        numbers = [name for name in columns if name not in set(texts)]
        table = pd.read_csv(
            io.StringIO(whole),
            dtype=dict.fromkeys(texts, str),
            keep_default_na=False,
            na_values={name: ["", "nan"] for name in numbers},
        )
        for name in integers if len(table) else ():
            if table[name].dtype.kind != "i" or (table[name] < 0).any():
                raise ValueError(f"{path}: {name} must be whole numbers >= 0.")
        return table


def _check_header(path: Path, text: str, columns: Sequence[str]) -> None:
    if (found := text.partition("\n")[0].split(",")) != list(columns):
        raise ValueError(f"{path} must have the columns {list(columns)}, got {found}.")
