"""`DemonstrationStore`: a folder of recorded episodes with which a killed run continues."""

from collections.abc import Iterator, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import pandas as pd

from modpush._arguments import checked_arguments
from modpush._atomic import clean_leftovers, make_folder
from modpush.data.demonstration import Demonstration
from modpush.evaluation.metrics import EpisodeMetrics
from modpush.evaluation.sealed_rows import append_row, begin_rows, read_rows
from modpush.files import read_json, reading, write_json
from modpush.parts import parts_named

__all__ = ["COLUMNS", "DemonstrationStore"]

_KIND, _VERSION = "modpush.Demonstrations", 1

COLUMNS = (
    "policy",
    "number",
    "seed",
    "scene",
    "pushed_object",
    "difficulty",
    "kept",
    *(field.name for field in fields(EpisodeMetrics)),
)
"""Columns of `attempts.csv`, which has a row for each episode that was run, and its checksum besides."""


class DemonstrationStore:
    """`run.json`, `attempts.csv` and a file for each kept episode under `episodes/<policy>/`.

    An episode's file is written before its row; a row that was cut off by a kill is dropped when the
    folder is opened again, and its episode runs anew.

    Args:
        folder: Made if it is not there.
        about: What is recorded, as plain data. A folder that holds something else is refused.

    Raises:
        ValueError: If the folder holds other demonstrations, or a file is damaged.
    """

    @checked_arguments
    def __init__(self, folder: Path | str, about: Mapping[str, Any]) -> None:
        self.folder = folder = make_folder(folder)
        self._allow = parts_named(about.get("env"))  # the caller's own
        if (folder / "run.json").exists():
            found = _read(folder / "run.json", "about")
            other = sorted(
                key for key in {*found, *about} if found.get(key, None) != about.get(key, None)
            )
            if other:
                differences = {key: (found.get(key), about.get(key)) for key in other}
                raise ValueError(
                    f"collect_demonstrations: {folder} holds other demonstrations, (there, asked "
                    f"for): {differences}. Choose another folder."
                )
        else:
            write_json(folder / "run.json", {"about": dict(about)}, _KIND, _VERSION)
        begin_rows(self._csv, COLUMNS)

    @property
    def _csv(self) -> Path:
        return self.folder / "attempts.csv"

    def claim_policy(self, name: str, about: Mapping[str, Any]) -> None:
        """Note which policy a name stands for.

        Args:
            name: The policy's name.
            about: What tells it from others, as plain data.

        Raises:
            ValueError: If the folder holds episodes of another policy of this name.
        """
        path = self.folder / "episodes" / name / "policy.json"
        if not path.exists():
            write_json(path, {"policy": dict(about)}, _KIND, _VERSION)
        found = _read(path, "policy")
        if found != about:
            raise ValueError(
                f"collect_demonstrations: {self.folder} holds episodes of another policy {name!r}, "
                f"{found}, got {dict(about)}. Choose another folder."
            )
        clean_leftovers(path.parent)

    def policies(self) -> dict[str, dict[str, Any]]:
        """What `claim_policy` noted, by name."""
        return {
            path.parent.name: _read(path, "policy")
            for path in sorted((self.folder / "episodes").glob("*/policy.json"))
        }

    def rows(self) -> pd.DataFrame:
        """All episodes that were run, one row for each, by policy and number.

        Raises:
            ValueError: If a row is damaged; the message says which.
        """
        rows = read_rows(
            self._csv,
            COLUMNS,
            integers=["number", "seed"],
            texts=["policy", "scene", "pushed_object"],
        )
        rows = rows.drop_duplicates(["policy", "number"], ignore_index=True)
        return rows.sort_values(["policy", "number"], ignore_index=True)

    def write(self, demonstration: Demonstration, metrics: EpisodeMetrics, kept: bool) -> None:
        """Add an episode that has ended."""
        if kept:
            demonstration.save(self._path(demonstration.policy, demonstration.number))
        scenario = demonstration.scenario
        about = {
            "policy": demonstration.policy,
            "number": demonstration.number,
            "seed": demonstration.seed,
            "scene": scenario.scene,
            "pushed_object": scenario.pushed_object,
            "difficulty": scenario.difficulty,
            "kept": kept,
        }
        append_row(self._csv, COLUMNS, about | metrics.to_dict())

    def read(self, rows: pd.DataFrame) -> Iterator[Demonstration]:
        """The kept episodes of some rows, in their order.

        Raises:
            FileNotFoundError: If a file is missing.
            ValueError: If one is damaged.
        """
        for row in rows.itertuples():
            path = self._path(str(row.policy), int(row.number))
            yield Demonstration.load(path, allow=self._allow)

    def _path(self, policy: str, number: int) -> Path:
        return self.folder / "episodes" / policy / f"{number:06d}.npz"


def _read(path: Path, key: str) -> dict[str, Any]:
    """The mapping under a key of a sealed file."""
    with reading(path, _KIND):
        return dict(read_json(path, _KIND, _VERSION)[key])
