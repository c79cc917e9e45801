"""Policies in two physics engines, episode by episode, from the results of `modpush evaluate`.

    modpush evaluate --policy any_object --set obstacles/small_cube --episodes 60
    modpush evaluate --policy any_object --set obstacles/small_cube --episodes 60 --engine mujoco
    python benchmarks/compare_engines.py --folder runs/evaluate --engine mujoco

For each policy and set that was run in both: share of solved episodes in either engine, share of
episodes with the same outcome, numbers of episodes that only one of them solves, and over episodes that
both solve the means of contact, collisions of object or arm, and steps, and the correlation of steps.
"""

from dataclasses import dataclass
from pathlib import Path

import pandas as pd
import tyro

from modpush.evaluation import format_table

MEASURES = ("contact_rate", "collision_rate", "steps")


@dataclass(frozen=True, kw_only=True)
class Config:
    """Results to compare."""

    folder: Path = Path("runs/evaluate")
    """Folder that `modpush evaluate` wrote to."""
    engine: str = "mujoco"
    """Engine beside the sets' own, as in the names of its folders."""


def compare(own: pd.DataFrame, other: pd.DataFrame) -> dict[str, str | float]:
    """One row of the table, from the rows of the episodes in both engines."""
    both = own.merge(other, on="episode", suffixes=("_a", "_b"))
    a, b = both["success_a"] > 0, both["success_b"] > 0
    solved = both[a & b]
    row: dict[str, str | float] = {
        "episodes": f"{len(both)}",
        "solved": f"{a.sum()} / {b.sum()}",
        "agreement": f"{(a == b).mean():.3f}",
        "only one": f"{(a & ~b).sum()} / {(b & ~a).sum()}",
    }
    for name in MEASURES:
        digits = 1 if name == "steps" else 3
        means = solved[[f"{name}_a", f"{name}_b"]].mean()
        row[name.removesuffix("_rate")] = " / ".join(f"{mean:.{digits}f}" for mean in means)
    row["correlation of steps"] = f"{solved['steps_a'].corr(solved['steps_b']):.2f}"
    return row


def main(config: Config) -> None:
    """Compare and print one table."""
    rows = {}
    for path in sorted(config.folder.glob(f"*/**/*+{config.engine}/episodes.csv")):
        own = path.parent.with_name(path.parent.name.removesuffix(f"+{config.engine}"))
        if (own / "episodes.csv").is_file():
            policy, *name = own.relative_to(config.folder).parts
            pair = pd.read_csv(own / "episodes.csv"), pd.read_csv(path)
            rows[f"`{policy}`, `{'/'.join(name)}`"] = compare(*pair)
    if not rows:
        raise SystemExit(f"{config.folder} has no set that was run in both engines.")
    table = pd.DataFrame.from_dict(rows, orient="index").rename_axis("policy, set")
    print(format_table(table))


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
