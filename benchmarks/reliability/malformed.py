"""Malformed inputs over the whole public surface: every one must be refused by a clear error.

    python benchmarks/reliability/malformed.py                  # 2,000 of them, some minutes of a core
    python benchmarks/reliability/malformed.py --seed 1 --show 20
    python benchmarks/reliability/malformed.py --log runs/malformed.jsonl  # goes on if interrupted

Targets, right arguments and the ways to make them wrong are in `tests/malformed`. An error is clear if
it is a ValueError, TypeError, KeyError, OSError or RuntimeError that names the argument (or the key)
and says what came or was expected, and was not raised inside numba, pydantic, SAPIEN or ManiSkill.
Cases run in a process of their own, so that one that crashes or hangs is counted and ends nothing.
"""

import json
import os
import select
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import tyro

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))
_START = 300.0  # seconds for a worker's imports and scenes


class Worker:
    """A process that runs cases by their numbers."""

    def __init__(self, seed: int) -> None:
        self.process = subprocess.Popen(
            [sys.executable, __file__, "--work", "--seed", str(seed)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "OMP_NUM_THREADS": "1"},
            text=True,
            encoding="utf-8",
            bufsize=1,
        )
        self.answer(_START)

    def run(self, number: int, seconds: float) -> dict[str, Any]:
        """What became of a case; a crash or a hang ends the process."""
        assert self.process.stdin is not None
        try:
            self.process.stdin.write(f"{number}\n")
        except BrokenPipeError:
            return {"outcome": "crash"}
        return self.answer(seconds)

    def answer(self, seconds: float) -> dict[str, Any]:
        """The next line that the process writes."""
        ready, _, _ = select.select([self.process.stdout], [], [], seconds)
        if not ready:
            self.process.kill()
            return {"outcome": "hang"}
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        return json.loads(line) if line else {"outcome": "crash"}


def work(seed: int) -> None:
    """Run the cases whose numbers come in."""
    import warnings

    import torch

    from tests.malformed.cases import judge, make_case, targets

    torch.set_num_threads(1)
    warnings.filterwarnings("ignore")
    out = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # what the cases print goes elsewhere
    targets()
    out.write("{}\n")
    for line in sys.stdin:
        try:
            case: Any = make_case(seed, int(line))
        except RuntimeError as error:  # a part of TorchRL that does not load here
            case, outcome, text = line.strip(), "not made", str(error)
        else:
            outcome, text = judge(case)
        out.write(json.dumps({"outcome": outcome, "case": str(case), "text": text}) + "\n")


def main(
    count: int = 2000,
    seed: int = 0,
    seconds: float = 60.0,
    show: int = 0,
    log: Path | None = None,
    work: bool = False,
) -> None:
    """Print a table of outcomes by part of the surface.

    Args:
        count: Number of malformed inputs.
        seed: Seed of what they are.
        seconds: After which a case counts as hanging.
        show: Number of cases that are printed of those that are not refused clearly.
        log: File of a line for each case. A count goes on with those that it holds, which must be of
            the same seed and the same code.
        work: Run cases whose numbers come in, for this command's own use.
    """
    if work:
        _work(seed)
        return
    outcomes: Counter[str] = Counter()
    cases: set[str] = set()
    shown = 0
    for number, result in enumerate(_results(count, seed, seconds, log)):
        outcomes[result["outcome"]] += 1
        cases.add(result.get("case", str(number)))
        if result["outcome"] != "clear" and shown < show:
            shown += 1
            print(f"{number} {result['outcome']}: {result.get('case')}: {result.get('text')}")
            sys.stdout.flush()
    names = ("clear", "accepted", "obscure", "crash", "hang", "not made")
    print(
        "| inputs | different | clear error | accepted | obscure error | crash | hang | not made |"
    )
    print("|---|---|---|---|---|---|---|---|")
    counted = " | ".join(str(outcomes[name]) for name in names)
    print(f"| {count} | {len(cases)} | {counted} |")


def _results(count: int, seed: int, seconds: float, log: Path | None) -> Iterator[dict[str, Any]]:
    """What became of each case: as the log says, and of the others by running them."""
    known = log.read_text(encoding="utf-8").splitlines() if log is not None and log.exists() else []
    yield from (json.loads(line) for line in known[:count])
    worker = Worker(seed) if len(known) < count else None
    for number in range(len(known), count):
        assert worker is not None
        result = worker.run(number, seconds)
        if result["outcome"] in ("crash", "hang"):
            worker = Worker(seed)
        if log is not None:
            with log.open("a", encoding="utf-8") as file:
                file.write(f"{json.dumps(result)}\n")
        yield result


_work = work

if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
