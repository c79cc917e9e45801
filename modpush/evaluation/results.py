"""Per-episode results on disk: a row as soon as an episode ends, so that a run can continue later."""

import csv
import functools
import inspect
import io
import os
from collections.abc import Mapping
from dataclasses import MISSING, fields
from pathlib import Path
from types import CodeType
from typing import Any

import pandas as pd
from tensordict.nn import TensorDictModuleBase
from torch import nn

from modpush._atomic import make_folder
from modpush._state import data_hash, weights_hash
from modpush._validation import checked_arguments
from modpush.evaluation.episodes import Episode, Trajectory
from modpush.evaluation.metrics import EpisodeMetrics
from modpush.evaluation.sets import EvaluationSet
from modpush.files import read_json, reading, write_json, write_text

_KIND, _VERSION = "modpush.Results", 2
_TRAJECTORIES = "trajectories"
SET_FILE = "set.json.gz"
"""File in a folder of results that holds the episodes, where these are not a set of the package."""

COLUMNS = (
    "episode",
    "scene",
    "pushed_object",
    "difficulty",
    "policy",
    *(field.name for field in fields(EpisodeMetrics) if field.default is MISSING),
)
"""Columns of `episodes.csv`, after which `final_yaw_error` follows where the goals are poses,
`OBSTACLE_COLUMNS` where obstacles can be moved, and `DYNAMICS_COLUMNS` where friction or centre of mass
are not always the usual ones. `policy` is the `policy_hash` of the policy."""
OBSTACLE_COLUMNS = ("path_share", "effort", "objects_toppled", "objects_off")
"""Columns about obstacles that can be moved, see `EpisodeMetrics`."""
DYNAMICS_COLUMNS = ("side_changes", "mass", "friction", "center_of_mass_x", "center_of_mass_y")
"""Changes of the pushed side, see `EpisodeMetrics`, and the object's `Dynamics`."""
_LIBRARIES = ("modpush", "tensordict", "torch", "torchrl")
"""Packages whose policies are told apart by their weights and settings."""
_TEXTS = ("scene", "pushed_object", "policy")


class ResultStore:
    """Results of one policy on one set: `episodes.csv`, `trajectories/` and `run.json` in a folder.

    Rows are written whole and flushed; a last row that was cut off by a kill is dropped when the
    folder is opened again, and its episode runs again.

    Args:
        folder: Created if it does not exist. One that holds all episodes already is only read.
        evaluation_set: The set that is run.
        policy: Plain data that distinguishes this policy and its settings from others, see
            `describe_policy`.
        resume: Continue with what the folder holds; False starts over and drops it.

    Raises:
        ValueError: If the folder holds results of another set, version or policy, its CSV has
            other columns.
    """

    @checked_arguments
    def __init__(
        self,
        folder: Path | str,
        evaluation_set: EvaluationSet,
        policy: Mapping[str, Any],
        *,
        resume: bool = True,
    ) -> None:
        self.folder, self.evaluation_set = make_folder(folder), evaluation_set
        self._policy = policy_hash(policy)
        if not resume:
            self.csv.unlink(missing_ok=True)
            self._about.unlink(missing_ok=True)
            for path in self.trajectories.glob("*.npz"):
                path.unlink()
        about = {
            "set": evaluation_set.name,
            "set_version": evaluation_set.version,
            "episodes": evaluation_set.digest,
            "conditions": evaluation_set.conditions.to_dict(),
            "policy": dict(policy),
        }
        self._claim(about)
        text, whole = self._read()
        if whole != text or not whole:
            write_text(self.csv, whole or ",".join(self.columns) + "\n")

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of `episodes.csv`."""
        conditions = self.evaluation_set.conditions
        return (
            *COLUMNS,
            *(("final_yaw_error",) if conditions.goal == "pose" else ()),
            *(OBSTACLE_COLUMNS if conditions.dynamic_obstacles else ()),
            *(DYNAMICS_COLUMNS if self.evaluation_set.hides_dynamics else ()),
        )

    @property
    def csv(self) -> Path:
        """The file with a row for each episode."""
        return self.folder / "episodes.csv"

    @property
    def trajectories(self) -> Path:
        """The folder with an `.npz` for each episode."""
        return self.folder / _TRAJECTORIES

    @property
    def _about(self) -> Path:
        return self.folder / "run.json"

    def _claim(self, about: dict[str, Any]) -> None:
        if self._about.exists():
            found = read_json(self._about, _KIND, _VERSION)
            other = {
                key: (found.get(key), value)
                for key, value in about.items()
                if found.get(key) != value
            }
            if other:
                raise ValueError(
                    f"ResultStore: {self.folder} holds another run (stored, expected): {other}. "
                    "Choose another folder, or start over with resume=False (--fresh)."
                )
            return
        if self.csv.exists() and self.csv.read_bytes().count(b"\n") > 1:
            raise ValueError(
                f"ResultStore: {self.folder} holds rows, but no {self._about.name} that says of which "
                "policy. Choose another folder, or start over with resume=False (--fresh)."
            )
        write_json(self._about, about, _KIND, _VERSION)

    def write(self, episode: Episode) -> None:
        """Add an episode's row and trajectory."""
        episode.trajectory.save(self.trajectories / f"{episode.number:05d}.npz")
        dynamics = episode.scenario.dynamics
        about = {
            "episode": episode.number,
            "scene": episode.scenario.scene,
            "pushed_object": episode.scenario.pushed_object,
            "difficulty": episode.scenario.difficulty,
            "policy": self._policy,
            "mass": dynamics.mass,
            "friction": dynamics.friction,
            "center_of_mass_x": dynamics.center_of_mass[0],
            "center_of_mass_y": dynamics.center_of_mass[1],
        }
        with self.csv.open("a", encoding="utf-8", newline="") as file:
            row = about | episode.metrics.to_dict()
            writer = csv.DictWriter(file, self.columns, extrasaction="ignore", lineterminator="\n")
            writer.writerow(row)
            file.flush()
            os.fsync(file.fileno())

    def rows(self) -> pd.DataFrame:
        """All finished episodes of the set, by number; those past its end are left out.

        Raises:
            ValueError: If a row is damaged; the message says which.
        """
        with reading(self.csv, "ResultStore"):
            rows = pd.read_csv(
                io.StringIO(self._read()[1]),
                dtype=dict.fromkeys(_TEXTS, str),  # text also where it looks like a number
                keep_default_na=False,
                na_values={name: ["", "nan"] for name in self.columns if name not in _TEXTS},
            )
        numbers = rows["episode"]
        if len(rows) and (numbers.dtype.kind != "i" or (numbers < 0).any()):
            raise ValueError(f"{self.csv}: episode must be whole numbers >= 0.")
        rows = rows.sort_values("episode", ignore_index=True)
        rows = rows[rows["episode"] < len(self.evaluation_set)]
        return rows.drop_duplicates("episode", ignore_index=True)

    def _read(self) -> tuple[str, str]:
        """Text of the CSV file, and its whole lines: a kill may have cut off the last one."""
        text = self.csv.read_text(encoding="utf-8") if self.csv.exists() else ""
        whole = text[: text.rfind("\n") + 1]
        if whole and (found := whole.partition("\n")[0].split(",")) != list(self.columns):
            raise ValueError(f"{self.csv} must have the columns {list(self.columns)}, got {found}.")
        return text, whole

    def missing(self) -> list[int]:
        """Numbers of the episodes still to run."""
        done = set(self.rows()["episode"])
        return [n for n in range(len(self.evaluation_set)) if n not in done]


@checked_arguments
def load_trajectory(folder: Path | str, number: int) -> Trajectory:
    """Trajectory of an episode, from a folder that a `ResultStore` filled."""
    return Trajectory.load(Path(folder) / _TRAJECTORIES / f"{number:05d}.npz")


def describe_policy(policy: Any, label: str = "") -> dict[str, Any]:
    """Identity of a policy and its settings, as plain data; `label` is further text to tell them apart.

    Its class or name counts, the weights and keys of a module, and the `config` of anything that has
    one. For a function, or an object of a class of your own, so does the source of the module that
    defines it, but not that of other modules. Arguments of a `functools.partial` do not count.
    """
    while isinstance(policy, functools.partial):
        policy = policy.func
    named = policy if hasattr(policy, "__qualname__") else type(policy)  # a function or a class
    described: dict[str, Any] = {
        "class": f"{named.__module__}:{named.__qualname__}",
        "label": label,
    }
    if named.__module__.partition(".")[0] not in _LIBRARIES:
        described["source"] = data_hash(_source(named))
    if isinstance(policy, nn.Module) and policy.state_dict():
        described["weights"] = weights_hash(policy)
    if isinstance(policy, TensorDictModuleBase):
        described["in_keys"] = [str(key) for key in policy.in_keys]
    if (config := getattr(policy, "config", None)) is not None:
        described["config"] = repr(config)
    return described


def _source(named: Any) -> str:
    """Source of the module of a function or class; where it has none, its own, or else its bytecode."""
    for part in (inspect.getmodule(named), named):
        try:
            return inspect.getsource(part)  # type: ignore[arg-type]  # None is a TypeError
        except (OSError, TypeError):
            continue
    code = getattr(named, "__code__", None)
    return "" if code is None else repr(_bytecode(code))


def _bytecode(code: CodeType) -> tuple[Any, ...]:
    constants = [_bytecode(c) if isinstance(c, CodeType) else c for c in code.co_consts]
    return code.co_code, code.co_names, constants


def policy_hash(described: Mapping[str, Any]) -> str:
    """A word that tells rows of different policies apart wherever they are copied to.

    `weights:` and `weights_hash` for what has weights; otherwise `settings:` and a hash of the
    description.
    """
    if weights := described.get("weights"):
        return f"weights:{weights}"
    return f"settings:{data_hash(dict(described))}"
