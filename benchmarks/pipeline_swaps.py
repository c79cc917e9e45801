"""Results of `examples/pipeline.py` with some lines exchanged, among obstacles.

    OMP_NUM_THREADS=1 python benchmarks/pipeline_swaps.py                # all, one after the other
    OMP_NUM_THREADS=1 python benchmarks/pipeline_swaps.py "no latent"    # one of them

Each variant trains for ten minutes of CPU time with seed 0. The table has the success rate of the
training episodes, with exploration noise, over 10,240 steps each.
"""

import argparse
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

PIPELINE = Path(__file__).resolve().parents[1] / "examples" / "pipeline.py"
TASK = ('scene="free"', 'scene=["free", *OBSTACLE_SCENES], difficulty=(0.0, 0.3)')
VARIANTS: dict[str, tuple[str, str] | None] = {
    "as it is": None,
    "no latent": ("entries=[latent, *names]", "entries=names"),
    "uniform replay": ("AttentiveSampler(k=4, num_queries=num_envs)", "RandomSampler()"),
    "straight lines": ('"distance_field", mode', '"straight_line", mode'),
}
"""Text that is replaced, and its replacement."""
IMPORTS = "from torchrl.data import RandomSampler\nfrom modpush.envs import OBSTACLE_SCENES\n"
WINDOW = 4  # printed lines, of 2,560 steps each


def run(change: tuple[str, str] | None, minutes: float) -> tuple[list[int], list[float]]:
    """Train a variant.

    Args:
        change: Text of the example to replace, and its replacement.
        minutes: CPU time after which the training ends [min].

    Returns:
        The steps and success rates of the printed lines.
    """
    source = PIPELINE.read_text(encoding="utf-8")
    for old, new in (TASK, *([change] if change else [])):
        if source.count(old) != 1:
            raise ValueError(f"{PIPELINE.name}: expected {old!r} once, got {source.count(old)}.")
        source = source.replace(old, new)
    steps: list[int] = []
    rates: list[float] = []

    def note(line: str, **_: Any) -> None:
        words = line.split()
        steps.append(int(words[0]))
        rates.append(float(words[-1]))
        print(line, flush=True)

    names: dict[str, Any] = {"__name__": "pipeline", "print": note}
    exec(compile(IMPORTS, PIPELINE, "exec"), names)
    exec(compile(source, PIPELINE, "exec"), names)
    names["time"] = SimpleNamespace(monotonic=time.process_time)  # the machine may be shared
    names["main"](steps=300_000, minutes=minutes)
    return steps, rates


def main() -> None:
    """Train the variants, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("variants", nargs="*", help=f"some of {[*VARIANTS]}; all by default")
    parser.add_argument("--minutes", type=float, default=10.0, help="CPU time of each variant")
    options = parser.parse_args()
    rows = []
    for name in options.variants or VARIANTS:
        print(f"{name}:", flush=True)
        run(VARIANTS[name], 0.0)  # compiles the kernels
        steps, rates = run(VARIANTS[name], options.minutes)
        last, half = rates[-WINDOW:], rates[: len(rates) // 2][-WINDOW:]
        rows.append(
            f"| {name} | {steps[-1]:,} | {sum(half) / len(half):.2f} | {sum(last) / len(last):.2f} |"
        )
    print("\n| variant | steps | success after half the steps | at the end |\n|---|---|---|---|")
    print("\n".join(rows))


if __name__ == "__main__":
    main()
