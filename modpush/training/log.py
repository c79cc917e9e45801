"""A run's log, as tables, as a picture and for TorchRL's loggers, and its progress bar."""

import logging
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pandas as pd
from torchrl.record.loggers import get_logger
from tqdm import tqdm

from modpush._extras import require_extra
from modpush.files import write_text
from modpush.training.config import TrainConfig
from modpush.training.run_folder import RunFolder

_METRICS = (
    "success",
    "spl",
    "contact_rate",
    "collision_rate",
    "collision_rate_object",
    "steps",
    "out_of_bounds",
)


class RunLog:
    """Writes the log's tables, and sends the same numbers to TorchRL's loggers.

    The rows are kept in memory and in the checkpoints; the tables are written again with every row.
    TorchRL's loggers start again with `begin`, so that they hold the same rows.

    Raises:
        MissingExtraError: If TensorBoard is asked for and not installed.
    """

    def __init__(self, config: TrainConfig, folder: RunFolder) -> None:
        if "tensorboard" in config.loggers:
            require_extra("RunLog: the logger 'tensorboard'", "tensorboard")
        self.folder = folder
        self.rows: list[dict[str, float]] = []
        """Rows of the training log."""
        self.evaluations: list[dict[str, float]] = []
        """Rows of the evaluations' table."""
        self._names = config.loggers
        self._loggers: list[Any] = []

    def begin(self) -> None:
        """Write a checkpoint's rows, or none; what the folder holds beyond them is dropped."""
        self.write_tables()
        for name in self._names:
            path = self.folder.path / "logs" / name
            shutil.rmtree(path, ignore_errors=True)
            logger = get_logger(name, logger_name=str(path), experiment_name="train")
            self._loggers.append(logger)
        for row in self.rows:
            self._send(int(row["step"]), {name: row[name] for name in row if name != "step"})
        for row in self.evaluations:
            self._send(int(row["step"]), _as_sent(row))

    def write(self, step: int, row: dict[str, float]) -> None:
        """Write a row of the training log."""
        self.rows.append({"step": step, **row})
        self.write_tables()
        self._send(step, row)

    def write_evaluation(
        self, step: int, updates: int, minutes: float, rows: pd.DataFrame
    ) -> dict[str, float]:
        """Write a row of the evaluations' table, from a row for each held-out episode; returns the means.

        Success by family is under `success/<family>`.
        """
        summary = {name: float(rows[name].astype(float).mean()) for name in _METRICS}
        families = rows.groupby("scene", sort=False)["success"].mean()
        summary |= {f"success/{name}": float(value) for name, value in families.items()}
        line = {"step": step, "updates": updates, "minutes": round(minutes, 3), **summary}
        self.evaluations.append(line)
        self.write_tables()
        self._send(step, _as_sent(line))
        return summary

    def write_tables(self) -> None:
        """Write both tables as they are in memory; what a folder holds beyond them is dropped."""
        for path, rows in (
            (self.folder.log, self.rows),
            (self.folder.evaluations, self.evaluations),
        ):
            if rows:
                write_text(path, pd.DataFrame(rows).to_csv(index=False))
            else:
                path.unlink(missing_ok=True)

    def _send(self, step: int, row: dict[str, float]) -> None:
        for logger in self._loggers:
            for name, value in row.items():
                logger.log_scalar(name, value, step=step)

    def close(self) -> None:
        """Flush what is buffered."""
        for logger in self._loggers:
            writer = getattr(logger.experiment, "close", None)
            if writer is not None:
                writer()


def _as_sent(evaluation: dict[str, float]) -> dict[str, float]:
    """A row of the evaluations' table as TorchRL's loggers get it."""
    about = ("step", "updates", "minutes")
    return {f"evaluation/{name}": value for name, value in evaluation.items() if name not in about}


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
        """Show a row of the log, the curriculum's level if there is one, and the best success so far.

        With `random` the actions are not the policy's yet.
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
        """Show an activity whose time does not count for the time left."""
        self.say(doing)
        try:
            yield
        finally:
            self._bar.unpause()
            self.say("")

    def say(self, doing: str) -> None:
        """Show an activity before the bar."""
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


_PANELS = (
    ("success", "success, greedy, held-out", (0.0, 1.02)),
    ("contact_rate", "contact rate", (0.0, 1.02)),
    ("collision_rate_object", "object collision rate", (0.0, None)),
)


def draw_curve(evaluations: Path, path: Path) -> None:
    """Draw the table of a run's evaluations (`evaluations.csv`) over its minutes of training.

    Raises:
        FileNotFoundError: If there is no such table.
    """
    import matplotlib

    matplotlib.use("Agg")  # no screen is needed
    import matplotlib.pyplot as plt

    table = pd.read_csv(evaluations)
    figure, axes = plt.subplots(1, len(_PANELS), figsize=(5 * len(_PANELS), 3.6))
    for axis, (column, title, limits) in zip(axes, _PANELS, strict=True):
        axis.plot(table["minutes"], table[column], marker=".")
        axis.set(title=title, xlabel="minutes", ylim=limits)
        axis.grid(alpha=0.3)
    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)
