"""Train variants and seeds of a configuration, several at a time or with Ray Tune.

    modpush sweep examples/sweeps/ablations.yaml --out runs/ablations --jobs 2
    modpush sweep examples/sweeps/ablations.yaml --out runs/ablations --groups replay encoder
    modpush sweep examples/sweeps/smoke.yaml --out /tmp/sweep --ray

The file names a training preset, the overrides common to all runs, the seeds, and the variants, with
fields by their dotted names in `modpush train`. The folder gets a training run's folder for every
variant and seed, and `trials.csv` (last and best evaluation of each), `curves.csv` and `curves.png`.
Started again, the sweep continues where it stopped. A run keeps two CPUs busy, or one with
`async_collection: false` among the overrides, with the same results. Ray
needs `pip install 'modpush[ray]'`.
"""

from collections.abc import Sequence
from pathlib import Path

import tyro

from modpush._types import Count, FilePath, Name, Several
from modpush._validation import checked
from modpush.cli.options import parse_options
from modpush.sweeps.definition import load_sweep
from modpush.sweeps.runner import run_sweep

__all__ = ["SweepConfig", "main"]


@checked
class SweepConfig:
    """A sweep and its folder."""

    sweep: tyro.conf.Positional[Name]
    """YAML file of the sweep, or `module:name` of a `Sweep` or of a list of variants."""
    out: FilePath = Path("runs/sweep")
    """Folder to write to."""
    groups: Several[Name] = ()
    """Groups of variants to run in addition to the first variant; all by default."""
    total_steps: Count | None = None
    """Environment steps of each run, instead of what the file says."""
    allow: Several[Name] = ()
    """Modules from which the file may import its author's own parts."""
    jobs: Count = 1
    """Number of runs at a time."""
    ray: bool = False
    """Let Ray Tune run as many runs at a time as there are CPUs for."""


def main(arguments: Sequence[str]) -> None:
    """`modpush sweep <arguments>`."""
    config = parse_options(SweepConfig, "modpush sweep", __doc__, arguments)
    sweep = load_sweep(config.sweep, allow=config.allow).of_groups(config.groups)
    results = run_sweep(
        sweep, config.out, jobs=config.jobs, ray=config.ray, total_steps=config.total_steps
    )
    columns = ["variant", "seed", "state", "step", "final_success", "best_success"]
    print(results.reindex(columns=columns).to_string(index=False))
    print(f"Wrote trials.csv, curves.csv and curves.png to {config.out}/.")
