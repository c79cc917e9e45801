"""Train the paper's agent: environment and learner side by side on two cores.

    python examples/train.py cpu --out runs/train            # what `make train` runs, 21 minutes
    python examples/train.py cpu --out runs/train --resume   # go on after an interrupt
    python examples/train.py smoke --out /tmp/smoke          # everything once, in some seconds
    python examples/train.py cpu --out runs/rays --train.env.encoder rays --train.seed 1

The folder gets `config.yaml`, `log.csv`, `evaluations.csv` (greedy, on held-out episodes), `curve.png`,
`best_agent.safetensors` (give it to `modpush.load_agent` or `examples/evaluate.py --policy`),
`checkpoints/`, and what TensorBoard reads in `logs/`. Ctrl-C writes a checkpoint and stops.
"""

import os

# One thread for the learner; the other core is the environment's. Before torch is imported.
os.environ.setdefault("OMP_NUM_THREADS", "1")

import signal
import sys
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import torch
import tyro

from modpush.training import TRAIN_PRESETS, TrainConfig, Trainer
from modpush.training.curve import draw_curve


@dataclass(frozen=True, kw_only=True)
class Run:
    """A training run and its folder."""

    train: TrainConfig = field(default_factory=TrainConfig)
    """Settings of the training run."""
    out: Path = Path("runs/train")
    """Folder of the run."""
    resume: bool = False
    """Resume the run in the folder from its newest checkpoint."""


def main(run: Run) -> dict[str, float]:
    """Train, and draw the learning curve."""
    torch.set_num_threads(1)
    print("The first run on a machine compiles for about a minute before the arm moves.")
    # Nothing has run in this process yet, so that the worker may share its libraries' memory.
    start_method: Literal["fork", "spawn"] = "fork" if sys.platform == "linux" else "spawn"
    trainer = Trainer(run.train, run.out, resume=run.resume, start_method=start_method)
    folder = trainer.folder

    def interrupt(*_: Any) -> None:
        # At the end of the present rollout, when all is in order; a second time means at once.
        if trainer.interrupted:
            raise KeyboardInterrupt
        trainer.interrupted = True

    for number in (signal.SIGINT, signal.SIGTERM):  # a polite kill ends a run as Ctrl-C does
        signal.signal(number, interrupt)
    try:
        best = trainer.run()
    finally:
        if folder.evaluations.exists():
            draw_curve([folder.path], folder.curve)
    print(
        f"Best on the held-out episodes: success {best['success']:.3f}, contact "
        f"{best['contact']:.3f}. Wrote {folder.best_agent} and {folder.curve}."
    )
    return best


if __name__ == "__main__":
    warnings.filterwarnings("ignore", message="Failed to find system libvulkan")
    presets = {
        name: (text, Run(train=config, out=Path("runs") / f"train_{name}"))
        for name, (text, config) in TRAIN_PRESETS.items()
    }
    chosen = tyro.extras.overridable_config_cli(presets, description=__doc__)
    try:
        main(chosen)
    except KeyboardInterrupt:
        print(f"\nStopped; a checkpoint is in {chosen.out}. Go on with --resume.")
        raise SystemExit(130) from None
