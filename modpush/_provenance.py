"""Where results come from: command, commit, machine and time."""

import os
import platform
import subprocess
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import modpush
from modpush.files import read_json, reading, write_json

__all__ = [
    "Session",
    "add_session",
    "commit",
    "forget_sessions",
    "machine",
    "read_sessions",
    "sources_text",
]

_KIND, _VERSION = "modpush.Sessions", 1
_NAME = "sessions.json"


@dataclass(frozen=True, kw_only=True)
class Session:
    """A stretch of time in which episodes or training runs were done."""

    commit: str
    """Commit of the code, see `commit`."""
    machine: str
    """The machine, see `machine`."""
    count: int
    """Number of episodes, or of training runs."""
    seconds: float
    """Time that they took [s]."""
    processes: int | str | None = None
    """Number of processes, or "ray"; None where it was not noted."""


def commit() -> str:
    """Commit of the code that runs, with a `+` where files differ from it; else modpush's version."""
    root = Path(modpush.__file__).parents[1]

    def git(*words: str) -> str:
        done = subprocess.run(
            ["git", "-C", str(root), *words],
            capture_output=True,
            text=True,
            encoding="utf-8",
            check=True,
        )
        return done.stdout.strip()

    try:
        # Not those of another project, whose environment modpush is installed in.
        git("ls-files", "--error-unmatch", "modpush/__init__.py")
        changed = "+" if git("status", "--porcelain", "--untracked-files=no", "modpush") else ""
        return git("rev-parse", "--short=10", "HEAD") + changed
    except (OSError, subprocess.CalledProcessError):
        return f"modpush {modpush.__version__}"


def machine() -> str:
    """Processor and number of cores of this machine."""
    name = platform.processor() or platform.machine()
    if (info := Path("/proc/cpuinfo")).exists():
        models = [
            line
            for line in info.read_text(encoding="utf-8").splitlines()
            if line.startswith("model name")
        ]
        name = models[0].partition(":")[2].strip() if models else name
    return f"{name}, {os.cpu_count()} cores"


def add_session(
    folder: Path, count: int, seconds: float, processes: int | str | None = None
) -> None:
    """Note in a folder of results what was done now.

    Args:
        folder: The folder, which holds `sessions.json`.
        count: Number of episodes, or of training runs.
        seconds: Time that they took [s].
        processes: Number of processes, or "ray".
    """
    session = Session(
        commit=commit(), machine=machine(), count=count, seconds=seconds, processes=processes
    )
    sessions = [vars(item) for item in (*read_sessions(folder), session)]
    write_json(folder / _NAME, {"sessions": sessions}, _KIND, _VERSION)


def forget_sessions(folder: Path) -> None:
    """Drop what `add_session` noted, for results that are measured anew."""
    (folder / _NAME).unlink(missing_ok=True)


def read_sessions(folder: Path) -> list[Session]:
    """What `add_session` noted; nothing for a folder without notes."""
    path = folder / _NAME
    if not path.exists():
        return []
    with reading(path, _KIND):
        return [Session(**item) for item in read_json(path, _KIND, _VERSION)["sessions"]]


def sources_text(
    command: str, sessions: Iterable[Session], seeds: str, time: str | None = None
) -> str:
    """The lines of a page that say how to make it again.

    Args:
        command: The command.
        sessions: When its results were measured.
        seeds: What random numbers depend on.
        time: What is said of the time; by default the sum of the sessions, for their episodes.
    """
    listed = list(sessions)
    commits = ", ".join(dict.fromkeys(item.commit for item in listed)) or commit()
    machines = "; ".join(dict.fromkeys(item.machine for item in listed)) or machine()
    if time is None:
        minutes = sum(item.seconds for item in listed) / 60
        time = f"{minutes:.1f} minutes for {sum(item.count for item in listed)} episodes"
        processes = {item.processes for item in listed}
        if len(processes) == 1 and None not in processes:  # earlier versions did not note it
            time += f", with `--workers {processes.pop()}`"
    return (
        f"| command | `{command}` |\n|---|---|\n| commit | {commits} |\n| seed | {seeds} |\n"
        f"| machine | {machines} |\n| time | {time} |\n"
    )
