"""The files of a training run, config, log, checkpoints and agents, and a trainer's state in them."""

import json
import re
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from torchrl.checkpoint import GlobalRNGState

from modpush._state import read_state, write_state
from modpush._validation import checked_arguments, from_plain
from modpush.files import read_yaml, reading, write_yaml
from modpush.recipes.agent_file import BEST_AGENT, observed_symmetry, save_agent
from modpush.recipes.fingerprint import fingerprint_differences
from modpush.training.config import TrainConfig, field_differences

if TYPE_CHECKING:
    from modpush.training.trainer import Trainer

_KIND, _VERSION = "modpush.TrainConfig", 1
CHECKPOINT_KIND, _CHECKPOINT_VERSION = "modpush.Checkpoint", 1
_CHECKPOINT_NAME = re.compile(r"step-(\d+)\.safetensors")


class RunFolder:
    """Names of the files in a run's folder.

    Args:
        path: The folder.
        keep_checkpoints: Number of newest checkpoints that are kept.
    """

    def __init__(self, path: str | Path, keep_checkpoints: int = 2) -> None:
        self.path = Path(path)
        self.config = self.path / "config.yaml"
        self.evaluations = self.path / "evaluations.csv"
        self.log = self.path / "log.csv"
        self.curve = self.path / "curve.png"
        self.best_agent = self.path / BEST_AGENT
        self.last_agent = self.path / "last_agent.safetensors"
        self.checkpoints = Checkpoints(self.path / "checkpoints", keep_checkpoints)

    def has_results(self) -> bool:
        """True if it holds results: more than the files that a run writes at its start."""
        names = {path.name for path in self.path.iterdir()} if self.path.exists() else set()
        if self.checkpoints.latest() or self.best_agent.exists() or self.last_agent.exists():
            return True
        begun = {self.config.name, self.log.name, "checkpoints", "logs", ".lock"}
        return any(name not in begun and not name.endswith(".tmp") for name in names)

    def write_config(self, config: TrainConfig) -> None:
        """Write the run's config as YAML; the folder is made."""
        plain = json.loads(json.dumps(asdict(config)))  # tuples as lists
        write_yaml(self.config, plain, _KIND, _VERSION)

    def stored_config(self) -> TrainConfig:
        """Inverse of `write_config`, to compare it with another config.

        Its parts may be in any modules: do not import the parts it names; `modpush train --config` checks
        them.

        Raises:
            ValueError: If the file is damaged or not a run's config; the message names it.
        """
        with reading(self.config, _KIND):
            return from_plain(TrainConfig, read_yaml(self.config, _KIND))


@checked_arguments
def check_run_folder(path: str | Path, config: TrainConfig, *, resume: bool) -> RunFolder:
    """Refuse a folder that this run must not write to, before any work is done.

    Args:
        path: The folder.
        config: The run's configuration.
        resume: Continue with what the folder holds; a run that was killed before its first checkpoint
            starts again.

    Raises:
        FileExistsError: If the folder is not empty and `resume` is False. A run that was killed
            before its first result does not count.
        FileNotFoundError: If there is nothing to resume.
        NotADirectoryError: If it is a file.
        ValueError: If the folder holds a run of another config; the message says what differs.
    """
    if Path(path).is_file():
        raise NotADirectoryError(f"check_run_folder: {path} is a file, expected a folder.")
    folder = RunFolder(path, config.keep_checkpoints)
    if not resume:
        if folder.has_results():
            raise FileExistsError(
                f"check_run_folder: {folder.path} is not empty; resume it, or give another folder."
            )
        return folder
    if not folder.config.exists():
        raise FileNotFoundError(
            f"check_run_folder: {folder.path} holds no checkpoint to resume from, and no run that "
            "was begun."
        )
    if different := config.differences(folder.stored_config()):
        raise ValueError(
            f"check_run_folder: {folder.path} holds a run of another config. What differs: "
            + "; ".join(different)
        )
    return folder


class Checkpoints:
    """Checkpoints in a folder, `step-<steps>.safetensors`, of which the `keep` newest are kept."""

    def __init__(self, folder: Path, keep: int = 2) -> None:
        self.folder, self.keep = folder, keep

    def paths(self) -> list[Path]:
        """All checkpoints, the newest last."""
        files = self.folder.iterdir() if self.folder.is_dir() else ()
        return sorted(filter(self.is_checkpoint, files), key=self.step)

    def latest(self) -> Path | None:
        """The newest checkpoint, if there is one."""
        return max(self.paths(), key=self.step, default=None)

    @staticmethod
    def is_checkpoint(path: Path) -> bool:
        """True if a path has a checkpoint's name."""
        return _CHECKPOINT_NAME.fullmatch(path.name) is not None

    @staticmethod
    def step(path: Path) -> int:
        """Environment steps after which a checkpoint was written."""
        return int(path.stem.removeprefix("step-"))

    def save(self, step: int, state: dict[str, Any]) -> None:
        """Write a checkpoint, then remove those that are too old; an OSError leaves those before."""
        path = self.folder / f"step-{step:09d}.safetensors"
        write_state(path, state, CHECKPOINT_KIND, _CHECKPOINT_VERSION)
        for old in self.paths()[: -self.keep]:
            old.unlink()

    def load(self) -> dict[str, Any]:
        """The state in the newest checkpoint; a ValueError if it is damaged."""
        newest = self.latest()
        if newest is None:
            raise FileNotFoundError(f"Checkpoints: {self.folder} holds no checkpoint.")
        try:
            return read_checkpoint(newest)
        except ValueError as error:
            raise ValueError(f"{error} Delete the file to resume from the one before.") from error


def read_checkpoint(path: Path) -> dict[str, Any]:
    """The state in a checkpoint's file; interpret it within `reading(path, CHECKPOINT_KIND)`."""
    state: dict[str, Any] = read_state(path, CHECKPOINT_KIND, _CHECKPOINT_VERSION)
    return state


def trainer_state(trainer: "Trainer") -> dict[str, Any]:
    """All that the rest of a run depends on between two rollouts, as tensors and plain data.

    A run that continues begins new episodes.
    """
    return {
        **trainer.learner.state(),
        "config": trainer.config.fixed_fields(),
        "fingerprint": trainer.specs.fingerprint,
        "symmetry": observed_symmetry(trainer.config.env, trainer.parts.get("pushed_object")),
        "rng": GlobalRNGState().state_dict(),
        "steps": trainer.steps,
        "checkpoints_made": trainer.checkpoints_made,
        "evaluation_due": trainer.evaluation_due,
        "seconds": trainer.seconds,
        "curriculum": trainer.curriculum_state,
        "episodes": dict(trainer.episodes),
        "log": trainer.log.rows,
        "evaluations": trainer.log.evaluations,
    }


def load_trainer_state(trainer: "Trainer", state: dict[str, Any]) -> None:
    """Inverse of `trainer_state`; a ValueError if the state is that of another run."""
    path = trainer.folder.checkpoints.latest() or trainer.folder.path
    with reading(path, CHECKPOINT_KIND):
        differences = fingerprint_differences(state["fingerprint"], trainer.specs.fingerprint)
        differences += field_differences(state["config"], trainer.config.fixed_fields())
    if differences:
        raise ValueError(
            f"Trainer: the checkpoints in {trainer.folder.path} are of another run: "
            + "; ".join(differences)
        )
    with reading(path, CHECKPOINT_KIND):
        trainer.learner.load_state(state)
        trainer.steps, trainer.seconds = state["steps"], state["seconds"]
        trainer.checkpoints_made = state["checkpoints_made"]
        trainer.evaluation_due = state.get("evaluation_due", False)  # older ones do not have it
        trainer.curriculum_state = state["curriculum"]
        trainer.episodes.update(state["episodes"])
        trainer.log.rows, trainer.log.evaluations = state["log"], state["evaluations"]
        GlobalRNGState().load_state_dict(state["rng"])


def save_trained_agent(trainer: "Trainer", path: Path, summary: dict[str, float]) -> None:
    """Write the agent as it is now, with its metrics on the held-out episodes."""
    config, learner = trainer.config, trainer.learner
    save_agent(
        path,
        learner.averaged_actor,
        config.env,
        hidden_sizes=config.tqc.hidden_sizes,
        observation_dim=learner.observation_dim,
        fingerprint=trainer.specs.fingerprint,
        actor=config.tqc.actor_network,
        encoder=config.tqc.encoder,
        image_key=config.tqc.image_key,
        parts=trainer.parts,
        make_env=trainer.make_env,
        metadata={
            "steps": trainer.steps,
            "updates": learner.updates,
            "minutes": round(trainer.minutes(), 1),
            "seed": config.seed,
            "held_out": summary,
        },
    )
