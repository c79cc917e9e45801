"""Learning curves of training runs beside each other, against steps, updates and minutes.

    modpush train paper --out runs/paper --train.no-save-buffer
    modpush train cpu --out runs/train
    python benchmarks/compare_runs.py --runs runs/paper runs/train --names paper cpu

Writes to `--out` the evaluations of each run, `curves.png`, and a table of where each run stood at some
of its evaluations. Runs that are under way may be compared as well.
"""

import shutil
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
import tyro

from modpush.training.curve import draw_curve, success_in_common

COLUMNS = {
    "step": "{:,.0f}",
    "updates": "{:,.0f}",
    "minutes": "{:.1f}",
    "success": "{:.3f}",
    "contact_rate": "{:.3f}",
    "collision_rate_object": "{:.3f}",
    "out_of_bounds": "{:.3f}",
    "level": "{:.0f}",
}


@dataclass(frozen=True, kw_only=True)
class CompareConfig:
    """Which runs are compared."""

    runs: tuple[Path, ...]
    """Folders of the runs."""
    names: tuple[str, ...]
    """What each run is called."""
    out: Path = Path("runs/compared")
    """Folder of what is written."""
    rows: int = 6
    """Number of evaluations of each run in the table, evenly spread, the last one included."""


def curriculum_level(folder: Path, steps: pd.Series) -> list[float]:
    """Number of the curriculum's stages that were passed at some steps."""
    log = pd.read_csv(folder / "log.csv")
    return [log.loc[log["step"] <= step, "curriculum/level"].iloc[-1] for step in steps]


def speeds(folder: Path) -> str:
    """Steps and updates a second of a whole run, evaluations included."""
    last = pd.read_csv(folder / "log.csv").iloc[-1]
    seconds = 60 * last["minutes"]
    return f"{last['step'] / seconds:.0f} steps/s and {last['updates'] / seconds:.1f} updates/s"


def table_of(name: str, table: pd.DataFrame, rows: int) -> list[str]:
    """Lines of a Markdown table."""
    last = len(table) - 1
    chosen = sorted({last, *(round(i * last / (rows - 1)) for i in range(rows - 1))})
    return [
        f"| {name} | " + " | ".join(form.format(table[c].iloc[i]) for c, form in COLUMNS.items())
        for i in chosen
    ]


def main(config: CompareConfig) -> None:
    if len(config.runs) != len(config.names):
        raise ValueError(
            f"compare_runs: names must be one for each run, got {len(config.names)} for "
            f"{len(config.runs)} runs."
        )
    config.out.mkdir(parents=True, exist_ok=True)
    tables = {}
    for name, folder in zip(config.names, config.runs, strict=True):
        shutil.copyfile(folder / "evaluations.csv", config.out / f"{name}_evaluations.csv")
        table = pd.read_csv(folder / "evaluations.csv")
        tables[name] = table.assign(level=curriculum_level(folder, table["step"]))
    families = success_in_common(list(tables.values()))
    named = dict(zip(config.names, config.runs, strict=True))
    draw_curve(named, config.out / "curves.png", against=("step", "updates", "minutes"))
    lines = [
        "| run | " + " | ".join(COLUMNS).replace("_", " ") + " |",
        "|" + "---|" * (len(COLUMNS) + 1),
    ]
    for name, table in tables.items():
        lines += [f"{line} |" for line in table_of(name, table, config.rows)]
    lines += ["", f"Success is the mean over {', '.join(families)}; the rest is over all episodes."]
    lines += [f"{name}: {speeds(folder)}." for name, folder in named.items()]
    (config.out / "table.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    print("\n".join(lines))


if __name__ == "__main__":
    main(tyro.cli(CompareConfig, description=__doc__))
