"""What is reproduced, with which agents, and where it is written."""

from collections.abc import Mapping
from dataclasses import field
from pathlib import Path
from typing import Literal, get_args

import tyro

from modpush._types import AtLeastOne, Count, FilePath, Name, Scenes, Seed, Several
from modpush._validation import checked

__all__ = ["PARTS", "Part", "ReproduceConfig"]

Part = Literal[
    "free", "obstacles", "hard", "examples", "runtime", "dynamics", "ablations", "further", "all"
]
PARTS = tuple(part for part in get_args(Part) if part != "all")
"""What can be reproduced, in the order of the companion page."""


_MATTERS: dict[str, tuple[str, ...]] = {
    "free": ("agent", "recovery", "first", "policy_files", "allow"),
    "obstacles": ("agent", "recovery", "first", "policy_files", "allow"),
    "hard": ("agent", "recovery", "first", "policy_files", "allow"),
    "examples": ("agent", "recovery", "first", "allow"),
    "runtime": ("agent", "recovery", "seed", "policy_files", "allow"),
    "dynamics": ("agent", "recovery", "seed", "dynamics_episodes", "allow"),
    "ablations": ("sweep",),
    "further": ("further",),
}
"""Fields of the configuration that each part's results depend on."""


@checked
class ReproduceConfig:
    """Parts of the paper, the agents, and where results are kept."""

    parts: tyro.conf.Positional[AtLeastOne[Part]] = ("all",)
    """Parts to reproduce: `free` (free space), `obstacles` (five families, four objects), `hard`
    (hard scenes), `examples` (pictures of episodes), `runtime` (computing times), `dynamics`
    (dynamics with which the agent was not trained), `ablations` and `further` (further training in
    the hard scenes), both from a sweep that has been run, or `all` of them."""
    agent: Name = "small_cube"
    """Agent that is evaluated everywhere, unchanged: the name of a shipped one, a training run's folder,
    or an agent's file."""
    recovery: bool | None = None
    """Whether `StuckRecovery` takes over when an agent has come to rest before the goal; by default
    what the agents' configs say."""
    policy_files: Mapping[Name, FilePath] = field(default_factory=dict)
    """Further agents, by the object with which they were trained, for the paper's retrained row:
    pairs of object and agent, which is the name of a shipped one, a training run's folder, or an
    agent's file."""
    first: Count | None = None
    """Number of episodes to run of each set, starting with its first; all by default."""
    num_envs: Scenes = 8
    """Number of scenes that each process steps together."""
    workers: Count | Literal["ray"] = 1
    """Number of processes, or `ray` for all CPUs of a Ray cluster."""
    seed: Seed = 20_261_122
    """Seed from which the scenarios of `dynamics` and `runtime` are drawn, which are in no set."""
    dynamics_episodes: Count = 100
    """Number of episodes for each value of each quantity in `dynamics`."""
    sweep: FilePath = Path("runs/ablations")
    """Folder of the sweep that `ablations` reads, as `modpush sweep` wrote it."""
    further: FilePath = Path("runs/hard_further")
    """Folder of the sweep that `further` reads."""
    rows: FilePath = Path("runs/reproduce")
    """Folder in which rows and trajectories are stored, so that only missing episodes run."""
    out: FilePath = Path("docs/results/paper")
    """Folder to which pages, tables and pictures are written."""
    fresh: bool = False
    """Run all episodes anew instead of continuing with the stored rows."""
    progress: bool = True
    """Show progress bars."""
    allow: Several[Name] = ()
    """Modules from which an agent's file may import its author's own parts."""

    @property
    def chosen(self) -> tuple[Part, ...]:
        """The parts asked for in the order of `PARTS`, `all` spelled out."""
        asked = set(PARTS) if "all" in self.parts else set(self.parts)
        return tuple(part for part in PARTS if part in asked)

    def command(self, part: str) -> str:
        """The command that makes a part again: with what it depends on, if not as by default.

        `rows` is left out, since it does not change the results, and so is an `out` that lies outside
        the current folder. A sweep's folder is named as below `runs`, wherever it lies.
        """
        words = ["modpush reproduce", part]
        for name in (*_MATTERS[part], "out"):
            value = self._argument(name, part)
            if value:
                words.append(f"--{name.replace('_', '-')} {value}")
        return " ".join(words)

    def _argument(self, name: str, part: str) -> str:
        """A field's value as `command` writes it; empty where it is the default or left out."""
        value = getattr(self, name)
        if name in ("sweep", "further"):
            value = Path("runs") / value.name
        if value == getattr(ReproduceConfig(), name):
            return ""
        if name == "policy_files":  # only `obstacles` has other objects than the small cube
            return " ".join(
                f"{item} {_agent_here(path)}"
                for item, path in value.items()
                if part == "obstacles" or item == "small_cube"
            )
        if name == "agent" and Path(value).is_absolute():
            return str(_agent_here(Path(value)))
        if name == "allow":
            return " ".join(value)
        if name == "out":
            return str(_below_here(value) or "")
        return str(value)


def _agent_here(path: Path) -> Path:
    """An agent's name or file as it was given, but without a folder that only this machine has."""
    return (_below_here(path) or Path(path.name)) if path.is_absolute() else path


def _below_here(path: Path) -> Path | None:
    """A path relative to the current folder; None if it lies elsewhere."""
    path, here = path.resolve(), Path.cwd()
    return path.relative_to(here) if path.is_relative_to(here) else None
