"""Runs that are killed at random moments: nothing is lost, and the numbers stay equal.

    python benchmarks/reliability/kills.py --count 20    # about 20 minutes on two idle cores

SIGKILL is sent to runs of the preset `smoke` at random moments: to the learner, to its worker, and to the
learner while it writes a checkpoint. Each run is started again until it ends, and its evaluations and its
last agent's weights are compared with those of an uninterrupted run.
"""

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd
import psutil
import torch
import tyro

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

from modpush.recipes import load_agent  # noqa: E402

RUN = """
import sys, warnings
from dataclasses import replace
from pathlib import Path
warnings.simplefilter("ignore")
if __name__ == "__main__":
    from modpush.training import TRAIN_PRESETS, Trainer
    config = replace(TRAIN_PRESETS["smoke"], async_collection=True)
    resume = (Path(sys.argv[1]) / "config.yaml").exists()
    try:
        Trainer(config, sys.argv[1], resume=resume, start_method="fork").run()
    except KeyboardInterrupt:
        raise SystemExit(130)
"""
TARGETS = ("learner", "worker", "checkpoint")


def numbers(folder: Path) -> tuple[pd.DataFrame, dict[str, torch.Tensor]]:
    """What must not depend on what happened to a run."""
    table = pd.read_csv(folder / "evaluations.csv").drop(columns="minutes")
    return table, load_agent(folder / "last_agent.safetensors").actor.state_dict()


def same(one: Path, other: Path) -> bool:
    """Whether two runs came to the same numbers, to the last bit."""
    (table, weights), (other_table, other_weights) = numbers(one), numbers(other)
    return table.equals(other_table) and all(
        torch.equal(value, other_weights[name]) for name, value in weights.items()
    )


def start(folder: Path) -> subprocess.Popen[bytes]:
    """Start or resume a run in a process group of its own."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    return subprocess.Popen(
        [sys.executable, "-c", RUN, str(folder)],
        start_new_session=True,
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def strike(process: subprocess.Popen[bytes], folder: Path, target: str, delay: float) -> bool:
    """Wait until a run steps its scenes and for a while more, then hit it; False if it has ended."""
    while not (folder / "config.yaml").exists():
        if process.poll() is not None:
            return False
        time.sleep(0.01)
    until = time.monotonic() + delay
    while time.monotonic() < until or (target == "checkpoint" and not writing(folder)):
        if process.poll() is not None:
            return False
        time.sleep(0.0005 if target == "checkpoint" else 0.01)
    children = psutil.Process(process.pid).children()
    (children[0] if target == "worker" and children else process).send_signal(signal.SIGKILL)
    process.wait()
    _, alive = psutil.wait_procs(children, timeout=30)
    assert not alive, "a worker outlived its parent"
    return True


def writing(folder: Path) -> bool:
    """Whether a checkpoint is being written."""
    return any((folder / "checkpoints").glob(".step-*"))


def kills(count: int = 20, seed: int = 0) -> None:
    """Print what became of runs that were hit `count` times for each target."""
    rng = np.random.default_rng(seed)
    print("| hit | runs | hits | lost | other numbers |\n|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as name:
        unbroken = Path(name) / "unbroken"
        began = time.monotonic()
        assert start(unbroken).wait() == 0
        length = 0.6 * (time.monotonic() - began)
        for target in TARGETS:
            runs = hits = lost = different = 0
            while hits < count:
                folder, runs = Path(name) / f"{target}{runs}", runs + 1
                for _ in range(4):
                    process = start(folder)
                    delay = 0.0 if target == "checkpoint" else rng.uniform(0.0, length)
                    hits += strike(process, folder, target, delay)
                lost += start(folder).wait() != 0
                different += not same(unbroken, folder)
                leftovers = list(folder.rglob(".*.tmp"))
                assert not leftovers, leftovers
            print(f"| {target} | {runs} | {hits} | {lost} | {different} |", flush=True)


if __name__ == "__main__":
    torch.set_num_threads(1)
    tyro.cli(kills, description=__doc__)
