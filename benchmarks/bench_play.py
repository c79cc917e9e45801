"""How fast the page's loop runs: the session's step, and what is sent to the page after it.

    python benchmarks/bench_play.py
    python benchmarks/bench_play.py --browser    # needs playwright and Chromium

A step must take less than 67 ms for the page to run at 15 Hz. The first table does not count the browser,
which draws in its own process. `--browser` opens the page in a headless Chromium that draws without a
GPU, on the same cores, and counts the steps that are taken and the pictures that it draws in a second:
the page asks for 15 steps, or for 60 at the speed 4.
"""

import argparse
import shutil
import threading
import time
import warnings

import numpy as np
import torch

from modpush.viewer import Page, PlayConfig

_STEPS = 150
_SECONDS = 15.0
_PICTURES = """seconds => new Promise(done => {
  let count = 0;
  const end = performance.now() + 1000 * seconds;
  const draw = now => { count += 1; now < end ? requestAnimationFrame(draw) : done(count / seconds); };
  requestAnimationFrame(draw);
})"""
_BROWSERS = ("chromium", "chromium-browser", "google-chrome")
_ARGUMENTS = [
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]


def measure(policy: tuple[str, ...], overlays: bool) -> tuple[float, float]:
    """Median time of a step and of drawing it [ms]."""
    page = Page(PlayConfig(policy=policy, port=0))
    page.controls.overlays.map = page.controls.overlays.window = overlays
    page.session.set_auto_continue(True)
    took = []
    for _ in range(_STEPS):
        start = time.perf_counter()
        page.session.tick()
        stepped = time.perf_counter()
        page.draw(force=True)
        took.append((stepped - start, time.perf_counter() - stepped))
    page.close()
    step, draw = 1e3 * np.median(took[20:], axis=0)
    return float(step), float(draw)


def measure_with_browser(
    policy: tuple[str, ...], overlays: bool, speed: float
) -> tuple[float, float]:
    """Steps taken and pictures drawn in a second while a browser shows the page."""
    from playwright.sync_api import sync_playwright

    chromium = next(filter(None, map(shutil.which, _BROWSERS)), None)
    if chromium is None:
        raise SystemExit(f"--browser needs one of {', '.join(_BROWSERS)}.")
    page = Page(PlayConfig(policy=policy, port=0))
    page.controls.overlays.map = page.controls.overlays.window = overlays
    page.controls.time.speed = speed
    page.session.set_auto_continue(True)
    ticks = 0
    tick = page.session.tick

    def counting_tick() -> None:
        nonlocal ticks
        tick()
        ticks += 1

    page.session.tick = counting_tick  # type: ignore[method-assign]
    running = threading.Thread(target=page.run)
    running.start()
    try:
        with sync_playwright() as driver:
            browser = driver.chromium.launch(executable_path=chromium, args=_ARGUMENTS)
            tab = browser.new_page(viewport={"width": 1000, "height": 620})
            tab.goto(page.address)
            tab.get_by_text("Single step").wait_for()
            tab.evaluate(_PICTURES, 5.0)  # until all is loaded and compiled
            before, start = ticks, time.perf_counter()
            pictures = tab.evaluate(_PICTURES, _SECONDS)
            steps = (ticks - before) / (time.perf_counter() - start)
            browser.close()
    finally:
        page.stop()
        running.join()
        page.close()
    return steps, float(pictures)


def print_table(browser: bool) -> None:
    """A row for each policy and choice of overlays; with a browser also for each speed."""
    head = ["speed", "steps a second", "pictures a second"]
    head = ["policies", "overlays", *(head if browser else ["step [ms]", "draw [ms]", "rate [Hz]"])]
    print(f"| {' | '.join(head)} |\n{'|---' * len(head)}|")
    for policy in (("agent",), ("corridor",), ("agent", "corridor")):
        for overlays in (False, True):
            shown = f"| {' + '.join(policy)} | {'all' if overlays else 'default'} |"
            if not browser:
                step, draw = measure(policy, overlays)
                print(f"{shown} {step:.1f} | {draw:.1f} | {1e3 / (step + draw):.0f} |")
                continue
            for speed in (1.0, 4.0):
                steps, pictures = measure_with_browser(policy, overlays, speed)
                print(f"{shown} {speed:g} | {steps:.1f} | {pictures:.1f} |", flush=True)


if __name__ == "__main__":
    warnings.filterwarnings("ignore", message="Failed to find system libvulkan")
    torch.set_num_threads(1)
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--browser", action="store_true", help="measure with a headless Chromium")
    print_table(parser.parse_args().browser)
