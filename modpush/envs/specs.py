"""The specs of `PushEnv`."""

from typing import Any

import torch
from torchrl.data import Binary, Bounded, Composite, Unbounded, UnboundedDiscrete

from modpush.envs.engines.base import CONTACT_KEYS
from modpush.envs.scenes.objects import SUPPORT_DIRECTIONS
from modpush.envs.scenes.obstacle import MAX_OBSTACLES
from modpush.geometry.camera import CAMERA

__all__ = ["ACTION_SIZE", "make_specs"]

ACTION_SIZE = 3
"""Length of an action: (dx, dy, dyaw)."""


def make_specs(
    num_envs: int, device: torch.device, images: bool, dynamic_obstacles: bool
) -> dict[str, Bounded | Composite]:
    """Specs of a batch of scenes, by the name of `EnvBase`'s attribute.

    Args:
        num_envs: Number of scenes, `B`.
        device: Device of the environment.
        images: Whether there are `depth` and `segmentation`.
        dynamic_obstacles: Whether there is `obstacle_displacement`.
    """
    shape: dict[str, Any] = {"shape": (num_envs,), "device": device}

    def real(size: int) -> Unbounded:
        return Unbounded((num_envs, size), device=device, dtype=torch.float32)

    def flag() -> Binary:
        return Binary(1, (num_envs, 1), device=device, dtype=torch.bool)

    def bounded(low: float, high: float, *sizes: int) -> Bounded:
        return Bounded(low, high, (num_envs, *sizes), device=device, dtype=torch.float32)

    observation: dict[str, Any] = {
        "object_pose": real(3),
        "goal_position": real(2),
        "ee_pose": real(3),
        "joint_position": real(6),
        "object_radius": real(1),
        "object_inscribed_radius": real(1),
        "object_symmetry": real(1),
        "object_support": real(SUPPORT_DIRECTIONS),
        **{key: flag() for key in CONTACT_KEYS},
        "target_reachable": flag(),
        "success": flag(),
        "out_of_bounds": flag(),
    }
    if dynamic_obstacles:
        observation["obstacle_displacement"] = real(MAX_OBSTACLES)
    if images:
        size = (1, CAMERA.height, CAMERA.width)
        observation["depth"] = bounded(0.0, CAMERA.z, *size)
        observation["segmentation"] = UnboundedDiscrete(
            (num_envs, *size), device=device, dtype=torch.uint8
        )
    done = {key: flag() for key in ("done", "terminated", "truncated")}
    return {
        "observation_spec": Composite(observation, **shape),
        "action_spec": bounded(-1.0, 1.0, ACTION_SIZE),
        "reward_spec": bounded(0.0, 1.0, 1),
        "done_spec": Composite(done, **shape),
    }
