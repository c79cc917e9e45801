"""The specs of `PushEnv`."""

from typing import Any

import torch
from torchrl.data import Binary, Bounded, Composite, Unbounded, UnboundedDiscrete

from modpush.envs.engines.base import CONTACT_KEYS
from modpush.envs.outcome import Goal
from modpush.envs.scenes.objects import SUPPORT_DIRECTIONS
from modpush.envs.scenes.obstacle import MAX_OBSTACLES
from modpush.geometry.camera import CAMERA

__all__ = ["ACTION_SIZE", "make_specs"]

ACTION_SIZE = 3
"""Length of an action: (dx, dy, dyaw)."""


def make_specs(
    num_envs: int,
    device: torch.device,
    num_joints: int,
    images: bool,
    dynamic_obstacles: bool,
    goal: Goal = "position",
    obstacle_motion: bool = False,
) -> dict[str, Bounded | Composite]:
    """Specs of a batch of scenes, by the name of `EnvBase`'s attribute.

    Args:
        num_envs: Number of scenes, `B`.
        device: Device of the environment.
        num_joints: Number of joints of the arm.
        images: Whether there are `depth` and `segmentation`.
        dynamic_obstacles: Whether there are `obstacle_displacement` and `obstacle_pose`.
        goal: What episodes ask for; with poses there are `goal_pose` and `pose_error`.
        obstacle_motion: Whether there is `obstacle_motion`.
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
        **({"goal_pose": 3, "pose_error": 2} if goal == "pose" else {}),
        **({"obstacle_displacement": MAX_OBSTACLES} if dynamic_obstacles else {}),
        **({"obstacle_motion": 4} if obstacle_motion else {}),
    }
    flags = (*CONTACT_KEYS, "target_reachable", "success", "out_of_bounds")
    observation: dict[str, Any] = {
        **{key: Unbounded((num_envs, size), **single) for key, size in numbers.items()},
        **{key: flag.clone() for key in flags},
    }
    if dynamic_obstacles:
        observation["obstacle_pose"] = Unbounded((num_envs, MAX_OBSTACLES, 4), **single)
    if images:
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
