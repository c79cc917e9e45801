"""Your own parts in a training run."""

import pickle
from collections.abc import Mapping
from typing import Any

from modpush.recipes.config import END_TO_END
from modpush.recipes.make_env import ENV_PARTS
from modpush.training.config import TrainConfig

LEARNER_PARTS = ("loss", "actor", "critic")
"""Parts that `make_tqc` takes as arguments."""
REPLAY_PARTS = ("sampler", "similarity")
"""Parts that `make_replay_buffer` takes as arguments."""


def check_parts(config: TrainConfig, parts: Mapping[str, Any], *, pickled: bool = False) -> None:
    """Refuse parts of an unknown kind and, if they are to be `pickled`, those that cannot be.

    Raises:
        ValueError: If there is one; the message says which.
    """
    known = (*ENV_PARTS, *LEARNER_PARTS, *REPLAY_PARTS)
    if unknown := sorted(set(parts) - set(known)):
        raise ValueError(f"parts has no {unknown}, expected some of {sorted(known)}.")
    if config.env.encoder == END_TO_END and not (config.tqc.encoder or "encoder" in parts):
        raise ValueError(
            f"env.encoder={END_TO_END!r} needs an encoder for the learner to train: "
            "tqc.encoder='modpush.encoders:ConvEncoder', 'module:name', or parts={'encoder': ...}."
        )
    if config.tqc.encoder and config.env.encoder != END_TO_END:
        raise ValueError(
            f"tqc.encoder={config.tqc.encoder!r} needs env.encoder={END_TO_END!r}, which "
            f"gives it images to encode, got {config.env.encoder!r}."
        )
    for kind, part in parts.items() if pickled else ():
        check_picklable(f"parts[{kind!r}]", part)


def check_picklable(name: str, part: Any) -> None:
    """Raise a ValueError for what a spawned process could not be given; `name` is for the message."""
    try:
        pickle.dumps(part)
    except Exception as error:
        raise ValueError(
            f"{name} must be picklable, since the environment runs in a process "
            f"of its own ({error}). Define it at the top level of a module, or use "
            "async_collection=False."
        ) from error


def learner_parts(config: TrainConfig, parts: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments of `make_tqc` among the parts, with an encoder that is trained with the agent."""
    trained = {"encoder"} if config.env.encoder == END_TO_END else set()
    return {kind: part for kind, part in parts.items() if kind in {*LEARNER_PARTS} | trained}


def replay_parts(parts: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments of `make_replay_buffer` among the parts."""
    return {kind: part for kind, part in parts.items() if kind in REPLAY_PARTS}
