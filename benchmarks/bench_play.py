"""How fast the page's loop runs: the session's step, and what is sent to the page after it.

    python benchmarks/bench_play.py

A step must take less than 67 ms for the page to run at 15 Hz. The browser, which draws in its own
process, is not counted.
"""

import time
import warnings

import numpy as np
import torch

from modpush.viewer import Page, PlayConfig

_STEPS = 150


def measure(policy: tuple[str, ...], overlays: bool) -> tuple[float, float]:
    """Median time of a step and of drawing it [ms]."""
    page = Page(PlayConfig(policy=policy, port=0))
    page.controls.overlays.map = overlays
    page.session.set_auto_continue(True)
    took = []
    for _ in range(_STEPS):
        start = time.perf_counter()
        page.session.tick()
        stepped = time.perf_counter()
        page.draw()
        took.append((stepped - start, time.perf_counter() - stepped))
    page.close()
    step, draw = 1e3 * np.median(took[20:], axis=0)
    return float(step), float(draw)


def print_table() -> None:
    """A row for each policy and choice of overlays."""
    print("| policies | overlays | step [ms] | draw [ms] | rate [Hz] |\n|---|---|---|---|---|")
    for policy in (("agent",), ("corridor",), ("agent", "corridor")):
        for overlays in (False, True):
            shown = f"| {' + '.join(policy)} | {'all' if overlays else 'default'} |"
            step, draw = measure(policy, overlays)
            print(f"{shown} {step:.1f} | {draw:.1f} | {1e3 / (step + draw):.0f} |")


if __name__ == "__main__":
    warnings.filterwarnings("ignore", message="Failed to find system libvulkan")
    torch.set_num_threads(1)
    print_table()
