"""Checkpoints of a training run, through TorchRL's `Checkpoint`."""

import errno
import shutil
import warnings
from typing import TYPE_CHECKING, Any

from torchrl.checkpoint import Checkpoint, GlobalRNGState

if TYPE_CHECKING:
    from modpush.training.trainer import Trainer

__all__ = ["load_checkpoint", "save_checkpoint"]


def save_checkpoint(trainer: "Trainer") -> None:
    """Write a checkpoint; where that fails, warn and leave the one before in place."""
    metadata = {
        "steps": trainer.steps,
        "updates": trainer.learner.updates,
        "checkpoints_made": trainer.checkpoints_made,
        "pending_updates": trainer.learner.pending_updates,
        "seconds": trainer.seconds,
        "best": list(trainer.best),
        "curriculum": trainer.curriculum_state,
    }
    try:
        _check_space(trainer)
        trainer.folder.checkpoints.save(_components(trainer), step=trainer.steps, metadata=metadata)
    except (OSError, RuntimeError) as error:  # torch's writer raises RuntimeError
        warnings.warn(
            f"Trainer: the checkpoint at step {trainer.steps} could not be written ({error}); "
            "the one before stays, training goes on.",
            stacklevel=2,
        )


def load_checkpoint(trainer: "Trainer") -> None:
    """Put a trainer into the state of its folder's newest checkpoint.

    Raises:
        FileNotFoundError: If there is none.
    """
    latest = trainer.folder.checkpoints.latest()
    if latest is None:
        raise FileNotFoundError(f"Trainer: {trainer.folder.path} holds no checkpoint.")
    checkpoint = _components(trainer)
    checkpoint.load(latest)
    metadata = checkpoint.manifest(latest)["metadata"]
    learner = trainer.learner
    trainer.steps, learner.updates = metadata["steps"], metadata["updates"]
    trainer.checkpoints_made = metadata["checkpoints_made"]
    learner.pending_updates = metadata["pending_updates"]
    trainer.seconds, trainer.best = metadata["seconds"], tuple(metadata["best"])
    trainer.curriculum_state = metadata["curriculum"]


def _components(trainer: "Trainer") -> Checkpoint:
    parts: dict[str, Any] = {
        "loss": trainer.learner.agent.loss,
        "optimizer": trainer.learner.agent.optimizer,
        "rng": GlobalRNGState(),
    }
    if trainer.config.save_buffer:
        parts["buffer"] = trainer.learner.buffer
    return Checkpoint(**parts)


def _check_space(trainer: "Trainer") -> None:
    # A memory-mapped buffer on a full disk would end the process, not raise.
    needed, buffer = 100_000_000, trainer.learner.buffer
    if trainer.config.save_buffer and len(buffer):
        needed += len(buffer) * buffer[:1].bytes()
    free = shutil.disk_usage(trainer.folder.path).free
    if free < needed:
        raise OSError(
            errno.ENOSPC, f"{free / 1e6:.0f} MB are free, {needed / 1e6:.0f} MB are needed"
        )
