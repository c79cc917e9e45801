"""A run's log: TorchRL's loggers, and one table each of the training and of the evaluations."""

from pathlib import Path
from typing import Any

import pandas as pd
from torchrl.record.loggers import get_logger

from modpush._extras import require_extra
from modpush.files import replacing
from modpush.training.config import TrainConfig
from modpush.training.run_folder import RunFolder

__all__ = ["RunLog"]

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

    Args:
        config: The run's configuration, which names TorchRL's loggers.
        folder: The run's folder.
        resumed_at: Step that a resumed run goes on from; what was logged after it is dropped.

    Raises:
        MissingExtraError: If TensorBoard is asked for and not installed.
    """

    def __init__(self, config: TrainConfig, folder: RunFolder, resumed_at: int | None) -> None:
        if "tensorboard" in config.loggers:
            require_extra("RunLog: the logger 'tensorboard'", "tensorboard")
        self.folder = folder
        logs = folder.path / "logs"
        self._loggers: list[Any] = [
            get_logger(name, logger_name=str(logs / name), experiment_name="train")
            for name in config.loggers
        ]
        self._rows: list[dict[str, float]] = []
        for path in (folder.log, folder.evaluations):
            if resumed_at is not None and path.exists():
                kept = pd.read_csv(path)
                _write(path, kept[kept["step"] <= resumed_at])
        if resumed_at is not None and folder.log.exists():
            self._rows = pd.read_csv(folder.log).to_dict("records")

    def write(self, step: int, row: dict[str, float]) -> None:
        """Write a row of the training log."""
        self._rows.append({"step": step, **row})
        _write(self.folder.log, pd.DataFrame(self._rows))
        self._send(step, row)

    def write_evaluation(
        self, step: int, updates: int, minutes: float, rows: pd.DataFrame
    ) -> dict[str, float]:
        """Write a row of the evaluations' table, from a row for each held-out episode.

        Returns:
            Means over the episodes, and success by family as `success/<family>`.
        """
        summary = {name: float(rows[name].astype(float).mean()) for name in _METRICS}
        families = rows.groupby("scene", sort=False)["success"].mean()
        summary |= {f"success/{name}": float(value) for name, value in families.items()}
        line = {"step": step, "updates": updates, "minutes": round(minutes, 3), **summary}
        table = pd.DataFrame([line])
        if self.folder.evaluations.exists():
            table = pd.concat([pd.read_csv(self.folder.evaluations), table])
        _write(self.folder.evaluations, table)
        self._send(step, {f"evaluation/{name}": value for name, value in summary.items()})
        return summary

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


def _write(path: Path, table: pd.DataFrame) -> None:
    with replacing(path) as unfinished:
        table.to_csv(unfinished, index=False)
