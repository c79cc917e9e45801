"""A trainer's state for a checkpoint, and its agent's file."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from torchrl.checkpoint import GlobalRNGState

from modpush.files import reading
from modpush.recipes.agent_file import observed_symmetry, save_agent
from modpush.recipes.fingerprint import fingerprint_differences
from modpush.training.config import field_differences
from modpush.training.run_folder import CHECKPOINT_KIND

if TYPE_CHECKING:
    from modpush.training.trainer import Trainer


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
    """Inverse of `trainer_state`.

    Raises:
        ValueError: If the state is that of another run, or of another structure.
    """
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
