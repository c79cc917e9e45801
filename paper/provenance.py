"""Origin of results: commit and machine, kept in a folder beside them."""

import json
import os
import platform
import subprocess
from collections.abc import Iterable, Mapping
from pathlib import Path

import modpush

__all__ = ["add_session", "commit", "machine", "origin_of", "sources_text", "this_origin"]

_NAME = "sessions.json"


def commit() -> str:
    """Commit of the code that runs, with a `+` where files differ from it; else modpush's version."""
    root = Path(modpush.__file__).parents[1]

    def git(*words: str) -> str:
        command = ["git", "-C", str(root), *words]
        return subprocess.run(
            command, capture_output=True, text=True, encoding="utf-8", check=True
        ).stdout.strip()

    try:
        # Not the commit of another project, in whose environment modpush is installed.
        git("ls-files", "--error-unmatch", "modpush/__init__.py")
        changed = "+" if git("status", "--porcelain", "--untracked-files=no", "modpush") else ""
        return git("rev-parse", "--short=10", "HEAD") + changed
    except (OSError, subprocess.CalledProcessError):
        return f"modpush {modpush.__version__}"


def machine() -> str:
    """Processor and number of cores of this machine."""
    name = platform.processor() or platform.machine()
    if (info := Path("/proc/cpuinfo")).exists():
        lines = info.read_text(encoding="utf-8").splitlines()
        models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
        name = models[0] if models else name
    return f"{name}, {os.cpu_count()} cores"


def this_origin() -> dict[str, str]:
    """Commit of the code that runs, and this machine."""
    return {"commit": commit(), "machine": machine()}


def add_session(folder: Path) -> None:
    """Note commit and machine in a folder of results, once for each pair."""
    sessions = _sessions(folder)
    here = this_origin()
    if here not in sessions:
        folder.mkdir(parents=True, exist_ok=True)
        text = json.dumps({"sessions": [*sessions, here]}, indent=1)
        (folder / _NAME).write_text(text, encoding="utf-8")


def origin_of(folder: Path) -> dict[str, str]:
    """Commits and machines that were noted in a folder; nothing for a folder without notes."""
    sessions = _sessions(folder)
    return {
        key: "; ".join(dict.fromkeys(session[key] for session in sessions))
        for key in ("commit", "machine")
        if sessions
    }


def _sessions(folder: Path) -> list[dict[str, str]]:
    path = folder / _NAME
    return json.loads(path.read_text(encoding="utf-8"))["sessions"] if path.exists() else []


def sources_text(command: str, seeds: str, origins: Iterable[Mapping[str, str]]) -> str:
    """The lines of a table that say how to make it again.

    Args:
        command: The command.
        seeds: Seed, or evaluation sets, that random numbers depend on.
        origins: `commit` and `machine` of each part, repetitions allowed.
    """
    commits, machines = zip(
        *((o.get("commit", ""), o.get("machine", "")) for o in origins), strict=True
    )
    lines = {
        "command": f"`{command}`",
        "commit": ", ".join(dict.fromkeys(commits)),
        "seed": seeds,
        "machine": "; ".join(dict.fromkeys(machines)),
    }
    head, *body = (f"| {name} | {value} |" for name, value in lines.items())
    return "\n".join([head, "|---|---|", *body]) + "\n"
