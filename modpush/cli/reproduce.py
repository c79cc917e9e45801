"""Reproduce the paper's tables and figures: ours beside the printed ones, with tests.

    modpush reproduce free
    modpush reproduce all --out docs/results/paper
    modpush reproduce obstacles --policy-files fragment runs/fragment/best_agent.safetensors
    modpush reproduce free --first 20 --out /tmp/paper --rows /tmp/rows     # a few minutes

Each part gets a page, `<part>.md`, and beside it LaTeX, CSV and pictures; `README.md` lists the pages
and where the agent is ahead, level or behind. Rows and trajectories are stored, so that an interrupted
run continues where it stopped; `--fresh` runs everything anew.
"""

from collections.abc import Sequence

from modpush.cli.options import parse_options
from modpush.reproduction.config import ReproduceConfig
from modpush.reproduction.run_parts import reproduce

__all__ = ["main"]


def main(arguments: Sequence[str]) -> None:
    """`modpush reproduce <arguments>`."""
    config = parse_options(ReproduceConfig, "modpush reproduce", __doc__, arguments)
    reproduce(config)
