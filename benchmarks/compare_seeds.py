"""Mean and worst of several training seeds on the evaluation sets, from the rows of `modpush evaluate`.

    python benchmarks/compare_seeds.py docs/results/agent docs/results/agent/seed_{1,2}
    python benchmarks/compare_seeds.py docs/results/any_object docs/results/any_object/seed_{1,2}

Each folder has the rows of one seed, `<set>.csv.gz`. Success and SPL are over all episodes of a set,
contact (any of four looks, and at the ends of steps) and collision (object or arm) over those that the
seed solved.
"""

from dataclasses import dataclass
from pathlib import Path

import pandas as pd
import tyro

from modpush.evaluation.tables import format_table, summarize

METRICS = {
    "success": "success",
    "spl": "SPL, exact",
    "spl_authors_agent": "SPL, authors'",
    "contact_rate": "contact",
    "contact_rate_at_end": "contact at ends",
    "collision_rate": "collision",
}
"""Columns of the rows, and what the table calls them."""


@dataclass(frozen=True)
class SeedsConfig:
    """Which seeds are compared."""

    folders: tyro.conf.Positional[tuple[Path, ...]]
    """Folders with the rows of a seed each."""


def seed_table(folders: tuple[Path, ...]) -> pd.DataFrame:
    """A line for each set: episodes, and `mean, worst` of each metric."""
    sets = [sorted(path.name for path in folder.glob("*.csv.gz")) for folder in folders]
    if not sets or not sets[0] or any(names != sets[0] for names in sets):
        raise ValueError(f"folders: all must have rows of the same sets, got {sets}.")
    lines = []
    for name in sets[0]:
        seeds = pd.concat(
            summarize({str(folder): pd.read_csv(folder / name)}) for folder in folders
        )
        if seeds["episodes"].nunique() > 1:
            counts = seeds["episodes"].tolist()
            raise ValueError(f"folders: all must have as many episodes of {name}, got {counts}.")
        line: dict[str, object] = {
            "set": name.removesuffix(".csv.gz"),
            "episodes": int(seeds["episodes"].iloc[0]),
        }
        for column, label in METRICS.items():
            worst = seeds[column].max() if column == "collision_rate" else seeds[column].min()
            line[label] = f"{seeds[column].mean():.3f}, {worst:.3f}"
        lines.append(line)
    return pd.DataFrame(lines).set_index("set")


if __name__ == "__main__":
    print(format_table(seed_table(tyro.cli(SeedsConfig).folders)))
