"""Per-episode results on disk: a row as soon as an episode ends, so that a run can go on later."""

import csv
import hashlib
import json
from dataclasses import fields
from pathlib import Path
from typing import Any

import pandas as pd

from modpush.evaluation.episodes import Episode, Trajectory
from modpush.evaluation.metrics import EpisodeMetrics
from modpush.evaluation.sets import EvaluationSet

__all__ = ["COLUMNS", "ResultStore", "load_trajectory"]

_TRAJECTORIES = "trajectories"

COLUMNS = (
    "episode",
    "scene",
    "pushed_object",
    "difficulty",
    *(field.name for field in fields(EpisodeMetrics)),
)
"""Of `episodes.csv`."""


class ResultStore:
    """A folder with `episodes.csv`, `trajectories/` and `run.json`, which says what was run.

    Rows are written whole and flushed; a last row that was cut off by a kill is dropped when the
    folder is opened again, and its episode runs anew.

    Args:
        folder: Made if it is not there.
        evaluation_set: What is run.
        label: What runs, any text that tells one policy and its settings from another.
        resume: Go on with what the folder holds; False starts over and drops it.

    Raises:
        ValueError: If the folder holds results of another set, version or policy, or its CSV has
            other columns.
    """

    def __init__(
        self, folder: Path, evaluation_set: EvaluationSet, label: str, *, resume: bool = True
    ) -> None:
        self.folder, self.evaluation_set = Path(folder), evaluation_set
        self.trajectories.mkdir(parents=True, exist_ok=True)
        if not resume:
            self.csv.unlink(missing_ok=True)
            self._about.unlink(missing_ok=True)
            for path in self.trajectories.glob("*.npz"):
                path.unlink()
        about = {
            "set": evaluation_set.name,
            "set_version": evaluation_set.version,
            "first_episode": _digest(evaluation_set),
            "policy": label,
        }
        self._claim(about)
        self._open()

    @property
    def csv(self) -> Path:
        """The rows."""
        return self.folder / "episodes.csv"

    @property
    def trajectories(self) -> Path:
        """One `.npz` an episode."""
        return self.folder / _TRAJECTORIES

    @property
    def _about(self) -> Path:
        return self.folder / "run.json"

    def _claim(self, about: dict[str, Any]) -> None:
        if self._about.exists():
            found = json.loads(self._about.read_text())
            other = {
                key: (found.get(key), value)
                for key, value in about.items()
                if found.get(key) != value
            }
            if other:
                raise ValueError(
                    f"ResultStore: {self.folder} holds another run, (there, expected): {other}. "
                    "Choose another folder, or start over with resume=False."
                )
        self._about.write_text(json.dumps(about, indent=1))

    def _open(self) -> None:
        """Write the header, or drop a row that was cut off."""
        header = ",".join(COLUMNS) + "\n"
        text = self.csv.read_text() if self.csv.exists() else ""
        whole = text[: text.rfind("\n") + 1]
        if whole and not whole.startswith(header):
            raise ValueError(
                f"ResultStore: {self.csv} must have the columns {list(COLUMNS)}, "
                f"got {whole.splitlines()[0].split(',')}."
            )
        if whole != text or not whole:
            self.csv.write_text(whole or header)

    def write(self, episode: Episode) -> None:
        """Keep an episode."""
        episode.trajectory.save(self.trajectories / f"{episode.number:05d}.npz")
        about = {
            "episode": episode.number,
            "scene": episode.scenario.scene,
            "pushed_object": episode.scenario.pushed_object,
            "difficulty": episode.scenario.difficulty,
        }
        with self.csv.open("a", newline="") as file:
            row = about | episode.metrics.to_dict()
            csv.DictWriter(file, COLUMNS, lineterminator="\n").writerow(row)

    def rows(self) -> pd.DataFrame:
        """All finished episodes of the set, by number; those past its end are left out."""
        rows = pd.read_csv(self.csv).sort_values("episode", ignore_index=True)
        rows = rows[rows["episode"] < len(self.evaluation_set)]
        return rows.drop_duplicates("episode", ignore_index=True)

    def missing(self) -> list[int]:
        """Numbers of the episodes still to run."""
        done = set(self.rows()["episode"])
        return [n for n in range(len(self.evaluation_set)) if n not in done]


def load_trajectory(folder: Path, number: int) -> Trajectory:
    """What an episode looked like, from a folder that a `ResultStore` filled."""
    return Trajectory.load(Path(folder) / _TRAJECTORIES / f"{number:05d}.npz")


def _digest(evaluation_set: EvaluationSet) -> str:
    first = json.dumps(evaluation_set.scenarios[0].to_dict(), sort_keys=True)
    return hashlib.sha256(first.encode()).hexdigest()[:16]
