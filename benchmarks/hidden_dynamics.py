"""Agents without a memory, with one, and told what is hidden: means of several runs, and differences.

    modpush evaluate --policy runs/without0 runs/without1 runs/without2 runs/memory0 ... \\
      --set hidden_dynamics hidden_dynamics_fine --episodes 200 --out runs/hidden
    python benchmarks/hidden_dynamics.py runs/hidden

The folder of a run is named after its kind and its seed. A difference between two kinds has the 95 %
interval of Welch's t-test, in which each run counts once: episodes of one run share its weights.
"""

import argparse
import itertools
import re
import statistics
from collections import defaultdict
from pathlib import Path

import pandas as pd
from scipy.stats import ttest_ind

LEVELS = {
    "mass": lambda rows: rows["mass"],
    "friction": lambda rows: rows["friction"],
    "centre of mass": lambda rows: (
        rows["center_of_mass_x"].abs() + rows["center_of_mass_y"].abs() > 0
    ).map({False: "in the middle", True: "off the middle"}),
    "object": lambda rows: rows["pushed_object"],
}
MEANS = ("success", "spl", "side_changes", "out_of_bounds")


def main() -> None:
    """Print the tables in Markdown, a set after the other."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folders", nargs="+", type=Path, help="where `modpush evaluate` wrote to")
    sets: dict[str, dict[str, list[pd.DataFrame]]] = defaultdict(lambda: defaultdict(list))
    for folder in parser.parse_args().folders:
        for file in sorted(folder.rglob("episodes.csv")):
            kind = re.sub(r"\d+$", "", file.parents[1].name)
            sets[file.parent.name][kind].append(pd.read_csv(file))
    for name, kinds in sorted(sets.items()):
        print(f"\n{name}\n\n{overview(kinds)}\n\n{differences(kinds)}\n\n{by_level(kinds)}")


def overview(kinds: dict[str, list[pd.DataFrame]]) -> str:
    """A row for each run: means over its episodes, steps over those that it solved."""
    table = [
        {
            "agent": kind,
            "run": k,
            "episodes": len(rows),
            **rows[[*MEANS]].mean(),
            "steps": rows["steps"][rows["success"]].mean(),
        }
        for kind, runs in kinds.items()
        for k, rows in enumerate(runs)
    ]
    return pd.DataFrame(table).to_markdown(index=False, floatfmt=".3f")


def differences(kinds: dict[str, list[pd.DataFrame]]) -> str:
    """Success of one kind less that of another, of all episodes and of those with the centre off."""
    table = []
    for one, other in itertools.combinations(kinds, 2):
        row: dict[str, object] = {"agents": f"{one} - {other}"}
        for label, only in (("all episodes", ""), ("centre off the middle", "off the middle")):
            ours, theirs = (
                [
                    rows["success"][LEVELS["centre of mass"](rows).str.contains(only)].mean()
                    for rows in kinds[kind]
                ]
                for kind in (one, other)
            )
            if min(len(ours), len(theirs)) > 1:
                low, high = ttest_ind(ours, theirs, equal_var=False).confidence_interval()
                difference = statistics.mean(ours) - statistics.mean(theirs)
                row[label] = f"{difference:+.3f} [{low:+.3f}, {high:+.3f}]"
        table.append(row)
    return pd.DataFrame(table).to_markdown(index=False)


def by_level(kinds: dict[str, list[pd.DataFrame]]) -> str:
    """Success by property, over all runs of a kind."""
    parts = []
    for label, level in LEVELS.items():
        columns = {}
        for kind, runs in kinds.items():
            rows = pd.concat(runs)
            columns[kind] = rows["success"].groupby(level(rows)).mean()
        part = pd.DataFrame(columns)
        part.index = [f"{label}: {value}" for value in part.index]
        parts.append(part)
    return pd.concat(parts).to_markdown(floatfmt=".2f")


if __name__ == "__main__":
    main()
