"""The entries that `PushEnv` emits in every step, and their specs."""

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torchrl.data import Binary, Bounded, Composite, Unbounded, UnboundedDiscrete

from modpush.envs.engines.base import CONTACT_KEYS
from modpush.envs.outcome import EpisodeStatus
from modpush.envs.scene_batch import Measurement, SceneBatch
from modpush.envs.scenes.objects import SUPPORT_DIRECTIONS
from modpush.envs.scenes.obstacle import MAX_OBSTACLES
from modpush.envs.simulation_config import SimulationConfig
from modpush.geometry.camera import CAMERA

ACTION_SIZE = 3
"""Length of an action: (dx, dy, dyaw)."""


def make_specs(
    num_envs: int, device: torch.device, num_joints: int, simulation: SimulationConfig
) -> dict[str, Bounded | Composite]:
    """Specs of a batch of scenes, by the name of `EnvBase`'s attribute.

    `num_joints` is that of the arm; `simulation` says which of the optional entries there are.
    """
    shape: dict[str, Any] = {"shape": (num_envs,), "device": device}
    single: Any = {"device": device, "dtype": torch.float32}
    flag = Binary(1, (num_envs, 1), device=device, dtype=torch.bool)
    numbers = {
        "object_pose": 3,
        "goal_position": 2,
        "ee_pose": 3,
        "joint_position": num_joints,
        "object_radius": 1,
        "object_inscribed_radius": 1,
        "object_symmetry": 1,
        "object_support": SUPPORT_DIRECTIONS,
        "tool_half_extents": 2,
        **({"goal_pose": 3, "pose_error": 2} if simulation.goal == "pose" else {}),
        **({"obstacle_displacement": MAX_OBSTACLES} if simulation.dynamic_obstacles else {}),
        **({"obstacle_motion": 4} if simulation.obstacle_motion else {}),
        **({"object_dynamics": 4} if simulation.object_dynamics else {}),
    }
    flags = (*CONTACT_KEYS, "target_reachable", "success", "out_of_bounds")
    observation: dict[str, Any] = {
        **{key: Unbounded((num_envs, size), **single) for key, size in numbers.items()},
        **{key: flag.clone() for key in flags},
    }
    if simulation.dynamic_obstacles:
        observation["obstacle_pose"] = Unbounded((num_envs, MAX_OBSTACLES, 4), **single)
    if simulation.depth is not None:
        size = (1, CAMERA.height, CAMERA.width)
        observation["depth"] = Bounded(0.0, CAMERA.z, (num_envs, *size), **single)
        observation["segmentation"] = UnboundedDiscrete(
            (num_envs, *size), device=device, dtype=torch.uint8
        )
    done = {key: flag.clone() for key in ("done", "terminated", "truncated")}
    return {
        "observation_spec": Composite(observation, **shape),
        "action_spec": Bounded(-1.0, 1.0, (num_envs, ACTION_SIZE), **single),
        "reward_spec": Bounded(0.0, 1.0, (num_envs, 1), **single),
        "done_spec": Composite(done, **shape),
    }


def state_entries(
    batch: SceneBatch,
    measured: Measurement,
    status: EpisodeStatus,
    pose_error: NDArray[np.float64] | None,
) -> dict[str, Tensor]:
    """The entries that describe the state of the scenes, on the CPU, see the table of `PushEnv`.

    Flags are `[B, 1]` bool and numbers `[B, n]` float32. `pose_error` is None for goal positions.

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
        **batch.about_object,
        "tool_half_extents": batch.tool_half_extents,
    }
    if pose_error is not None:
        numbers |= {"goal_pose": batch.goal_pose, "pose_error": pose_error}
    entries = {key: torch.from_numpy(value[:, None].copy()) for key, value in flags.items()}
    for key, value in numbers.items():
        entries[key] = torch.from_numpy(value.astype(np.float32))
    return entries
