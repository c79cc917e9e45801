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
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import tyro

from modpush._processes import torch_threads
from modpush.evaluation.sets import BEHIND_SETS, EVALUATION_SETS, SET_NAMES
from paper.blocks import AGENTS, BLOCKS, write_blocks
from paper.dynamics import measure_dynamics
from paper.examples import write_examples
from paper.measure import Running, run_methods
from paper.rows import ROWS, collect_rows, write_rows
from paper.runtime import measure_runtime
from paper.set_statistics import set_table
from paper.statistics import RETRAINED
from paper.sweep import load_trials, run_trials
from paper.sweep_results import collect_trials, draw_sweep, sweep_text
from paper.tables import CONTROLLERS

__all__ = ["COMMANDS", "main"]

_SEED = 20_261_122  # of scenarios that are in no set


@dataclass(frozen=True, kw_only=True)
class Run(Running):
    """Run methods on the evaluation sets."""

    methods: tuple[str, ...] = (*AGENTS, RETRAINED, *CONTROLLERS)
    """Methods: what `modpush evaluate --policy` takes, or `fragment`, the agent that was trained further
    with the fragment."""
    sets: tuple[str, ...] = (*EVALUATION_SETS, *BEHIND_SETS)
    """Names of the sets."""
    first: int | None = None
    """Number of episodes of each set, starting with its first; all by default."""

    def __call__(self) -> None:
        run_methods(self, self.methods, self.sets, self.first)


@dataclass(frozen=True, kw_only=True)
class CollectRows:
    """Add the rows of finished evaluations to the file of rows."""

    folder: tyro.conf.Positional[Path] = Path("runs/paper")
    """Folder that `python -m paper run` or `modpush evaluate --out` filled."""
    rename: Mapping[str, str] = field(default_factory=dict)
    """Names of methods, as pairs of the folder's name and the new one."""
    first: int | None = None
    """Number of episodes to take of each set, starting with its first; all by default."""
    commit: str = "not noted"
    """Commit of the code, for folders that do not say."""
    machine: str = "not noted"
    """Machine, for folders that do not say."""
    out: Path = ROWS
    """The file."""

    def __call__(self) -> None:
        frames = collect_rows(
            self.folder,
            self.rename,
            self.out,
            first=self.first,
            commit=self.commit,
            machine=self.machine,
        )
        print(write_rows(frames, self.out).to_string(index=False))


@dataclass(frozen=True, kw_only=True)
class Tables:
    """Write tables of the pages from the rows."""

    names: tyro.conf.Positional[tuple[str, ...]] = ()
    """Names of the tables; all by default."""

    def __call__(self) -> None:
        if unknown := sorted(set(self.names) - set(BLOCKS)):
            raise ValueError(f"tables: names must be some of {sorted(BLOCKS)}, got {unknown}.")
        texts = {}
        for name in self.names or BLOCKS:
            try:
                texts[name] = BLOCKS[name]()
            except KeyError as missing:
                print(f"{name}: left as it is. {missing.args[0]}")
        _write(texts)


@dataclass(frozen=True, kw_only=True)
class Examples(Running):
    """Draw episodes of an agent and the controller, chosen by a rule."""

    agent: str = "small_cube"
    """The agent."""
    first: int | None = None
    """Number of episodes to choose from; all of the set by default."""

    def __call__(self) -> None:
        text = write_examples(self, self.agent, self.first)
        _write({"examples": text})


@dataclass(frozen=True, kw_only=True)
class Runtime:
    """Measure the computing times of a control step."""

    agent: str = "small_cube"
    """The agent."""
    seed: int = _SEED
    """Seed from which the scenarios are drawn."""

    def __call__(self) -> None:
        text = measure_runtime(self.agent, self.seed)
        _write({"runtime": text})


@dataclass(frozen=True, kw_only=True)
class Dynamics(Running):
    """Measure an agent under dynamics, sizes and sensors that it was not trained with."""

    agent: str = "small_cube"
    """The agent."""
    episodes: int = 100
    """Number of episodes for each value of each quantity."""
    seed: int = _SEED
    """Seed from which the scenarios are drawn."""

    def __call__(self) -> None:
        text = measure_dynamics(self, self.agent, self.episodes, self.seed)
        _write({"dynamics": text})


@dataclass(frozen=True, kw_only=True)
class Sets:
    """Print distances, free straight lines and the lengths of shortest paths of evaluation sets."""

    names: tyro.conf.Positional[tuple[str, ...]] = SET_NAMES
    """Names of the sets."""

    def __call__(self) -> None:
        print(set_table(self.names))


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """Train variants and seeds of a configuration."""

    sweep: tyro.conf.Positional[Path]
    """YAML file of the sweep."""
    out: Path = Path("runs/sweep")
    """Folder to write to."""
    groups: tuple[str, ...] = ()
    """Groups of variants to run besides the first variant; all by default."""
    total_steps: int | None = None
    """Environment steps of each run, instead of what the file says."""
    jobs: int = 1
    """Number of runs at a time."""
    page: bool = False
    """Write the table and the figure to the page of docs/results that is named after the sweep."""

    def __call__(self) -> None:
        trials = load_trials(self.sweep, self.groups, self.total_steps)
        try:
            failed = run_trials(trials, self.out, self.jobs)
        finally:
            tables = collect_trials(trials, self.out)
            draw_sweep(tables[1], self.out / "curves.png")
        command = f"python -m paper sweep {self.sweep} --out runs/{self.out.name} --page"
        text = sweep_text(*tables, command, self.out)
        print(text)
        if self.page:
            draw_sweep(tables[1], ROWS.parent / f"{self.sweep.stem}.png")
            _write({self.sweep.stem: text})
        if failed:
            raise RuntimeError(f"sweep: {len(failed)} of {len(trials)} runs failed: {failed}.")


def _write(texts: Mapping[str, str]) -> None:
    for page in write_blocks(texts):
        print(f"Wrote {page.relative_to(ROWS.parents[2])}.")


COMMANDS: dict[str, type[Any]] = {
    "run": Run,
    "rows": CollectRows,
    "tables": Tables,
    "examples": Examples,
    "runtime": Runtime,
    "dynamics": Dynamics,
    "sets": Sets,
    "sweep": Sweep,
}
"""The subcommands; each is its options, and runs when it is called."""


def main(arguments: Sequence[str] | None = None) -> int:
    """`python -m paper <subcommand> <arguments>`; the exit status."""
    name, *rest = [*(sys.argv[1:] if arguments is None else arguments)] or ["--help"]
    if name not in COMMANDS:
        print(
            __doc__ if name in ("-h", "--help") else f"paper: no {name!r}, there are {[*COMMANDS]}."
        )
        return 0 if name in ("-h", "--help") else 2
    command = COMMANDS[name]
    options = tyro.cli(command, prog=f"python -m paper {name}", args=rest)
    with torch_threads(1):
        try:
            options()
        except KeyboardInterrupt:
            print(f"\npaper {name}: stopped; the same command continues.", file=sys.stderr)
            return 130
        except (ValueError, OSError, RuntimeError, KeyError) as error:
            print(f"paper {name}: {error}", file=sys.stderr)
            return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
