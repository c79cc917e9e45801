"""The entries that `PushEnv` emits in every step, as tensors by key."""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from modpush.envs.engines.base import CONTACT_KEYS
from modpush.envs.outcome import EpisodeStatus
from modpush.envs.scene_batch import Measurement, SceneBatch

__all__ = ["state_entries"]


def state_entries(
    batch: SceneBatch,
    measured: Measurement,
    status: EpisodeStatus,
    pose_error: NDArray[np.float64] | None,
) -> dict[str, Tensor]:
    """The entries that describe the state of the scenes, on the CPU.

    Args:
        batch: The scenes, for what stays the same throughout an episode.
        measured: Their present state.
        status: How their episodes stand.
        pose_error: Their distances and turns from goal poses, `[B, 2]`; None for goal positions.

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
        "goal_position": batch.goal_pose[:, :2],
        "ee_pose": measured.ee_pose,
        "joint_position": measured.joint_position,
        "object_radius": batch.object_radius,
        "object_inscribed_radius": batch.object_inscribed_radius,
        "object_symmetry": batch.object_symmetry,
        "object_support": batch.object_support,
    }
    if pose_error is not None:
        numbers |= {"goal_pose": batch.goal_pose, "pose_error": pose_error}
    entries = {key: torch.from_numpy(value[:, None].copy()) for key, value in flags.items()}
    for key, value in numbers.items():
        entries[key] = torch.from_numpy(value.astype(np.float32))
    return entries
