"""Makes the chosen parts one after the other, and the page over them."""

from collections.abc import Callable
from dataclasses import replace

from modpush._arguments import checked_arguments
from modpush._folder_lock import FolderLock
from modpush._threads import torch_threads
from modpush.reproduction.ablations import write_ablations, write_further
from modpush.reproduction.companion import write_companion
from modpush.reproduction.config import ReproduceConfig
from modpush.reproduction.dynamics import write_dynamics
from modpush.reproduction.example_pictures import write_example_pictures
from modpush.reproduction.measure import methods_for
from modpush.reproduction.paper_tables import PAPER_TABLES, write_paper_table
from modpush.reproduction.runtime import write_runtime

__all__ = ["reproduce"]

_WRITERS: dict[str, Callable[[ReproduceConfig], None]] = {
    "examples": write_example_pictures,
    "runtime": write_runtime,
    "dynamics": write_dynamics,
    "ablations": write_ablations,
    "further": write_further,
}


@checked_arguments
def reproduce(config: ReproduceConfig) -> None:
    """Make the chosen parts, and `README.md` after each.

    With `all`, ablations and further training are left out where no sweep has been run.

    Raises:
        FileNotFoundError: If one of these is asked for by name and there is no sweep.
        ValueError: Before an episode is run, if an agent or an object of `policy_files` is unknown; later
            if the rows kept are of another agent.
    """
    _check_agents(config)
    sweeps = {"ablations": config.sweep, "further": config.further}
    with FolderLock(config.rows), torch_threads(1):
        for part in config.chosen:
            sweep = None if part in config.parts else sweeps.get(part)
            if sweep is not None and not (sweep / "curves.csv").exists():
                print(f"{part}: left out, no sweep in {sweep}.")
                continue
            if part in PAPER_TABLES:
                write_paper_table(part, config)
            elif part == "examples" and "obstacles" in config.chosen:
                _WRITERS[part](replace(config, fresh=False))  # of episodes that were just run
            else:
                _WRITERS[part](config)
            write_companion(config)
            print(f"Wrote {config.out / part}.md.")


def _check_agents(config: ReproduceConfig) -> None:
    """Load every agent that the chosen tables are of."""
    objects = sorted({s.pushed_object for table in PAPER_TABLES.values() for s in table.sections})
    if unknown := sorted(set(config.policy_files) - set(objects)):
        raise ValueError(
            f"ReproduceConfig: policy_files must be of objects of the tables, {objects}, got {unknown}."
        )
    if set(config.chosen) & set(PAPER_TABLES):
        for pushed_object in config.policy_files or objects[:1]:
            methods_for(config, pushed_object)
