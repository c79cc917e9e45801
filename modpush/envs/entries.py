"""The entries that `PushEnv` emits in every step, as tensors by key."""

import numpy as np
import torch
from torch import Tensor

from modpush.envs.engines.base import CONTACT_KEYS
from modpush.envs.outcome import EpisodeStatus
from modpush.envs.scene_batch import Measurement, SceneBatch

__all__ = ["state_entries"]


def state_entries(
    batch: SceneBatch, measured: Measurement, status: EpisodeStatus
) -> dict[str, Tensor]:
    """The entries that need no option of `PushEnv`, on the CPU.

    Args:
        batch: The scenes, for what stays the same throughout an episode.
        measured: Their present state.
        status: How their episodes stand.

    Returns:
        Flags `[B, 1]` bool and numbers `[B, n]` float32, see the table of `PushEnv`.

    Raises:
        RuntimeError: If the simulation has failed, so that a pose is not finite.
    """
    finite = np.isfinite(measured.object_pose[:, :2]).all(-1)
    if not finite.all():
        index = int(np.argmin(finite))
        raise RuntimeError(f"PushEnv: physics gave a non-finite object pose in scene {index}.")
    flags = {
        **dict(zip(CONTACT_KEYS, measured.contacts.T, strict=True)),
        "target_reachable": measured.target_reachable,
        **status._asdict(),
    }
    numbers = {
        "object_pose": measured.object_pose,
        "goal_position": batch.goal_position,
        "ee_pose": measured.ee_pose,
        "joint_position": measured.joint_position,
        "object_radius": batch.object_radius,
        "object_inscribed_radius": batch.object_inscribed_radius,
        "object_symmetry": batch.object_symmetry,
        "object_support": batch.object_support,
    }
    entries = {key: torch.from_numpy(value[:, None].copy()) for key, value in flags.items()}
    for key, value in numbers.items():
        entries[key] = torch.from_numpy(value.astype(np.float32))
    return entries
