"""Rows of episodes: from the folders that `evaluate` fills to one Parquet file, and back.

The file has a row for each method, set and episode. The lengths by which the paper's authors measured
their methods depend on the start of an episode alone and are added here; the three SPL follow from them.
"""

import functools
import json
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from modpush.evaluation.sets import SET_NAMES, EvaluationSet, load_set
from paper.authors_paths import authors_agent_length, authors_controller_length
from paper.provenance import origin_of

__all__ = ["ROWS", "Rows", "add_yardsticks", "collect_rows", "read_rows", "write_rows"]

ROOT = Path(__file__).resolve().parents[1]
ROWS = ROOT / "docs" / "results" / "rows.parquet"
_LENGTHS = {
    "authors_agent_length": authors_agent_length,
    "authors_controller_length": authors_controller_length,
}
_SPL = {
    "spl": "shortest_length",
    "spl_authors_agent": "authors_agent_length",
    "spl_authors_controller": "authors_controller_length",
}
"""Each SPL, and the length of the path that it is measured by."""
_TEXTS = ("method", "set", "scene", "commit", "machine")
_NUMBERS = (
    "contact_rate",
    "contact_rate_at_end",
    "collision_rate",
    "collision_rate_object",
    "collision_rate_arm",
    "collision_rate_at_end",
    "collision_rate_object_at_end",
    "path_length",
    "shortest_length",
    *_LENGTHS,
    "mean_jerk",
    "reversal_rate",
)
"""Columns that are kept in single precision; NaN where rows are of a version that had none."""
_SPREAD = ("path_length", "mean_jerk")  # hardly a value occurs twice
_KEPT = (*_TEXTS, "episode", "success", "steps", *_NUMBERS)


def add_yardsticks(
    rows: pd.DataFrame, episodes: EvaluationSet, known: pd.DataFrame | None = None
) -> pd.DataFrame:
    """Rows with the authors' lengths [m], and SPL by the exact and by both of the authors' paths.

    Args:
        rows: What `evaluate` returned, or some columns of it.
        episodes: The set, whose scenarios have the numbers in `episode`.
        known: Rows of any methods on the same set that have the lengths, which take tenths of a second
            to compute; they are used for the episodes whose shortest path is as long.
    """
    lengths = rows[["episode", "shortest_length"]].reset_index(drop=True)
    if known is not None:
        others = known.drop_duplicates("episode")[["episode", "shortest_length", *_LENGTHS]]
        lengths = lengths.merge(others, "left", on="episode", suffixes=("", "_known"))
        same = np.isclose(lengths["shortest_length"], lengths["shortest_length_known"], atol=1e-6)
        lengths.loc[~same, [*_LENGTHS]] = np.nan
    for name, measure in _LENGTHS.items():
        if name not in rows:
            found = lengths.get(name, pd.Series(np.nan, lengths.index))
            rows = rows.assign(
                **{
                    name: [
                        measure(episodes.scenarios[number]) if np.isnan(length) else length
                        for number, length in zip(lengths["episode"], found, strict=True)
                    ]
                }
            )
    return _with_spl(rows)


def _with_spl(rows: pd.DataFrame) -> pd.DataFrame:
    """Rows with success weighted by path length, `S * l / max(p, l)`, for each reference length l."""
    taken = rows["path_length"]
    return rows.assign(
        **{
            spl: rows["success"] * rows[length] / np.maximum(taken, rows[length])
            for spl, length in _SPL.items()
        }
    )


def collect_rows(
    folder: Path,
    rename: Mapping[str, str] | None = None,
    path: Path = ROWS,
    *,
    first: int | None = None,
    **origin: str,
) -> Iterator[pd.DataFrame]:
    """Rows of all finished evaluations of sets of the package below a folder.

    Args:
        folder: Folder with `.../<method>/<set>/episodes.csv` and `run.json`, as `modpush evaluate` and
            `python -m paper run` write them.
        rename: Names of methods, by the names of their folders.
        path: File with earlier rows, whose authors' lengths are used.
        first: Number of episodes to take of each set, starting with its first; all by default.
        **origin: `commit` and `machine`, where the folders do not say.

    Yields:
        The rows of a method on a set, as `write_rows` takes them. Unfinished evaluations are named on
        standard output and left out.
    """
    earlier = Rows(path) if path.exists() else None
    for found in sorted(folder.rglob("episodes.csv")):
        name = json.loads((found.parent / "run.json").read_text(encoding="utf-8")).get("set", "")
        parts, plain = Path(name).parts, name.partition("+")[0]
        if plain not in SET_NAMES or found.parent.parts[-len(parts) :] != parts:
            continue
        rows = pd.read_csv(found).drop_duplicates("episode").sort_values("episode")
        episodes = load_set(plain).first(first)
        rows = rows[rows["episode"] < len(episodes)]
        method = found.parent.parts[-len(parts) - 1]
        if len(rows) < len(episodes):
            print(f"{method} on {name}: {len(rows)} of {len(episodes)} episodes, left out.")
            continue
        about = {"commit": "", "machine": "", **origin, **origin_of(found.parent)}
        about |= {"method": (rename or {}).get(method, method), "set": name}
        known = earlier.of_any(plain) if earlier is not None else None
        yield add_yardsticks(rows.assign(**about), episodes, known)


def write_rows(frames: Iterator[pd.DataFrame], path: Path = ROWS) -> pd.DataFrame:
    """Add rows to the file; they replace those of the same methods and sets.

    Args:
        frames: Rows with the columns `method`, `set`, `commit` and `machine`.
        path: The file.

    Returns:
        The number of rows by method and set, as added.

    Raises:
        ValueError: If there are none.
    """
    added = pd.concat([frame.reindex(columns=[*_KEPT]) for frame in frames], ignore_index=True)
    keys = ["method", "set"]
    table = added
    if path.exists():
        before = pd.read_parquet(path).astype(dict.fromkeys(_TEXTS, str))
        replaced = before.set_index(keys).index.isin(added.set_index(keys).index)
        table = pd.concat([before[~replaced], added], ignore_index=True)
    table = table.sort_values([*keys, "episode"], ignore_index=True)
    table = table.astype(dict.fromkeys(_TEXTS, "category") | dict.fromkeys(_NUMBERS, np.float32))
    table = table.astype({"episode": np.int16, "steps": np.int16, "success": bool})
    path.parent.mkdir(parents=True, exist_ok=True)
    table.to_parquet(
        path,
        index=False,
        compression="zstd",
        compression_level=19,
        use_dictionary=[name for name in _KEPT if name not in (*_SPREAD, "success", "episode")],
        column_encoding={
            **dict.fromkeys(_SPREAD, "BYTE_STREAM_SPLIT"),
            "episode": "DELTA_BINARY_PACKED",
        },
    )
    return added.groupby(keys, sort=False).size().rename("episodes").reset_index()


class Rows:
    """The file's rows, by method and set.

    Args:
        path: The file.

    Raises:
        FileNotFoundError: If there is no such file.
    """

    def __init__(self, path: Path = ROWS) -> None:
        table = pd.read_parquet(path)
        table = table.astype(dict.fromkeys(_TEXTS, str) | dict.fromkeys(_NUMBERS, float))
        self._frames = dict(iter(table.groupby(["method", "set"])))

    def __contains__(self, key: tuple[str, str]) -> bool:
        return key in self._frames

    def of_any(self, evaluation_set: str) -> pd.DataFrame | None:
        """Rows of any method on a set; None if there are none."""
        frames = (f for (_, name), f in self._frames.items() if name == evaluation_set)
        return max(frames, key=len, default=None)

    def of(self, method: str, evaluation_set: str) -> pd.DataFrame:
        """Rows of a method on a set, by episode, with the three SPL.

        Raises:
            KeyError: If the file has none; the message says how to add them.
        """
        try:
            return _with_spl(self._frames[method, evaluation_set].reset_index(drop=True))
        except KeyError:
            raise KeyError(
                f"Rows: none of {method!r} on {evaluation_set!r}; run `python -m paper run` and "
                "`python -m paper rows`."
            ) from None


@functools.cache
def read_rows(path: Path = ROWS) -> Rows:
    """The rows in the repository, read once."""
    return Rows(path)
