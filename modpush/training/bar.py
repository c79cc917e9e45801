"""The progress bar of a training run."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager

from tqdm import tqdm

from modpush.training.config import TrainConfig

__all__ = ["TrainingBar"]


class TrainingBar:
    """Environment steps, with the latest figures; it shows nothing if the config says so.

    The time left is that of the training alone: evaluations and checkpoints stop its clock.
    """

    def __init__(self, config: TrainConfig, steps: int = 0) -> None:
        self._config = config
        self._bar = tqdm(
            total=config.total_steps,
            initial=steps,
            unit="step",
            disable=not config.progress,
            smoothing=0.02,
        )

    def advance(self, steps: int) -> None:
        """Add environment steps."""
        self._bar.update(steps)

    def show(self, row: dict[str, float], random: bool, level: str, best: float | None) -> None:
        """Show a row of the log.

        Args:
            row: The row.
            random: Whether the policy does not act yet.
            level: Level of the curriculum; empty if there is none.
            best: Success of the best evaluation so far; None before the first.
        """
        success = row.get("greedy/success", row.get("noisy/success"))
        actor = self._config.first_actions if random else "policy"
        shown = {
            f"success ({actor})": None if success is None else f"{success:.2f}",
            "level": level or None,
            "best": None if best is None else f"{best:.3f}",
            "steps/s": f"{row['speed/steps']:.0f}",
            "updates/s": None if random else f"{row['speed/updates']:.0f}",
        }
        self._bar.set_postfix({k: v for k, v in shown.items() if v is not None}, refresh=False)

    @contextmanager
    def pause(self, doing: str) -> Iterator[None]:
        """Say what is done meanwhile, and let it not count for the time left."""
        self.say(doing)
        try:
            yield
        finally:
            self._bar.unpause()
            self.say("")

    def say(self, doing: str) -> None:
        """Say what is done, before the bar."""
        self._bar.set_description_str(doing)

    def close(self) -> None:
        """Leave the bar as it is."""
        self._bar.close()


@contextmanager
def quiet_torchrl() -> Iterator[None]:
    """Within this block TorchRL logs warnings only: it announces each storage, in colours."""
    logger = logging.getLogger("torchrl")
    level = logger.level
    logger.setLevel(logging.WARNING)
    try:
        yield
    finally:
        logger.setLevel(level)
