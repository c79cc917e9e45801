"""Comparison with the paper: episodes, tables, pictures and sweeps, from a clone of the repository.

    python -m paper run --workers 2           # all episodes of the tables, hours
    python -m paper rows                      # their rows into docs/results/rows.parquet
    python -m paper tables                    # the tables of all pages from these rows, a minute
    python -m paper tables success agents     # some of them
    python -m paper examples                  # pictures of episodes
    python -m paper runtime                   # computing times on this machine
    python -m paper dynamics                  # masses, frictions, sizes and cameras not trained with
    python -m paper sets                      # distances and shortest paths of the evaluation sets
    python -m paper sweep paper/sweeps/ablations.yaml --out runs/ablations --jobs 2 --page

Each subcommand but `run` and `rows` writes its tables between the comments `<!-- results: NAME -->` and
`<!-- end -->` of the pages, and its pictures to docs/results. What was run is kept, so that the same
command continues after an interrupt.
"""

import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import tyro

from modpush._processes import torch_threads
from modpush.evaluation.sets import SET_NAMES
from paper.blocks import BLOCKS, write_blocks
from paper.dynamics import measure_dynamics
from paper.examples import write_examples
from paper.measure import run_methods
from paper.rows import ROWS, collect_rows, write_rows
from paper.runtime import measure_runtime
from paper.set_statistics import set_table
from paper.sweep import load_trials, run_trials
from paper.sweep_results import collect_trials, draw_sweep, sweep_text

__all__ = ["COMMANDS", "main"]


def add_rows(
    folder: tyro.conf.Positional[Path] = Path("runs/paper"),
    *,
    rename: Mapping[str, str] | None = None,
    first: int | None = None,
    commit: str = "not noted",
    machine: str = "not noted",
    out: Path = ROWS,
) -> None:
    """Add the rows of finished evaluations to the file of rows.

    Args:
        folder: Folder that `python -m paper run` or `modpush evaluate --out` filled.
        rename: Names of methods, as pairs of the folder's name and the new one.
        first: Number of episodes to take of each set, starting with its first; all by default.
        commit: Commit of the code, for folders that do not say.
        machine: Machine, for folders that do not say.
        out: The file.
    """
    frames = collect_rows(folder, rename, out, first=first, commit=commit, machine=machine)
    print(write_rows(frames, out).to_string(index=False))


def write_tables(names: tyro.conf.Positional[tuple[str, ...]] = ()) -> None:
    """Write tables of the pages from the rows.

    Args:
        names: Names of the tables; all by default.
    """
    if unknown := sorted(set(names) - set(BLOCKS)):
        raise ValueError(f"tables: names must be some of {sorted(BLOCKS)}, got {unknown}.")
    texts = {}
    for name in names or BLOCKS:
        try:
            texts[name] = BLOCKS[name]()
        except KeyError as missing:
            print(f"{name}: left as it is. {missing.args[0]}")
    _write(texts)


def print_sets(names: tyro.conf.Positional[tuple[str, ...]] = SET_NAMES) -> None:
    """Print distances, free straight lines and the lengths of shortest paths of evaluation sets.

    Args:
        names: Names of the sets.
    """
    print(set_table(names))


def run_sweep(
    sweep: tyro.conf.Positional[Path],
    *,
    out: Path = Path("runs/sweep"),
    groups: tuple[str, ...] = (),
    total_steps: int | None = None,
    jobs: int = 1,
    page: bool = False,
) -> None:
    """Train variants and seeds of a configuration.

    Args:
        sweep: YAML file of the sweep.
        out: Folder to write to.
        groups: Groups of variants to run besides the first variant; all by default.
        total_steps: Environment steps of each run, instead of what the file says.
        jobs: Number of runs at a time.
        page: Write the table and the figure to the page of docs/results that is named after the sweep.
    """
    trials = load_trials(sweep, groups, total_steps)
    try:
        failed = run_trials(trials, out, jobs)
    finally:
        tables = collect_trials(trials, out)
        draw_sweep(tables[1], out / "curves.png")
    command = f"python -m paper sweep {sweep} --out runs/{out.name} --page"
    text = sweep_text(*tables, command, out)
    print(text)
    if page:
        draw_sweep(tables[1], ROWS.parent / f"{sweep.stem}.png")
        _write({sweep.stem: text})
    if failed:
        raise RuntimeError(f"sweep: {len(failed)} of {len(trials)} runs failed: {failed}.")


def _write(texts: Mapping[str, str]) -> None:
    for page in write_blocks(texts):
        print(f"Wrote {page.relative_to(ROWS.parents[2])}.")


COMMANDS: dict[str, Callable[..., Any]] = {
    "run": run_methods,
    "rows": add_rows,
    "tables": write_tables,
    "examples": write_examples,
    "runtime": measure_runtime,
    "dynamics": measure_dynamics,
    "sets": print_sets,
    "sweep": run_sweep,
}
"""The subcommands; a text that one returns is the table of its name."""


def main(arguments: Sequence[str] | None = None) -> int:
    """`python -m paper <subcommand> <arguments>`; the exit status."""
    name, *rest = [*(sys.argv[1:] if arguments is None else arguments)] or ["--help"]
    if name not in COMMANDS:
        print(
            __doc__ if name in ("-h", "--help") else f"paper: no {name!r}, there are {[*COMMANDS]}."
        )
        return 0 if name in ("-h", "--help") else 2
    flat = (tyro.conf.OmitArgPrefixes,)
    with torch_threads(1):
        try:
            text = tyro.cli(COMMANDS[name], prog=f"python -m paper {name}", args=rest, config=flat)
            if text is not None:
                _write({name: text})
        except KeyboardInterrupt:
            print(f"\npaper {name}: stopped; the same command continues.", file=sys.stderr)
            return 130
        except (ValueError, OSError, RuntimeError, KeyError) as error:
            print(f"paper {name}: {error}", file=sys.stderr)
            return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
