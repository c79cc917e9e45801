"""The state of the task as a plain Gymnasium environment, for instance for Stable-Baselines3."""

import math
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from tensordict import TensorDictBase

from modpush.envs.push_env import PushEnv
from modpush.envs.single_scene import SingleSceneEnv, check_arguments

__all__ = ["OBSERVATION_KEYS", "PushGymEnv"]

OBSERVATION_KEYS = (
    "object_pose",
    "goal_position",
    "ee_pose",
    "joint_position",
    "object_contact",
    "obstacle_contact",
    "tool_obstacle_contact",
)
"""Keys of `PushEnv` that make up the observation, of 3 + 2 + 3 + 6 + 1 + 1 + 1 numbers."""


class PushGymEnv(SingleSceneEnv):
    """One scene of `PushEnv`, as `gymnasium.make("ClutterPushState-v1")`.

    The observation is the state without the obstacles, `[17]` float32, in the order of
    `OBSERVATION_KEYS`; the action is `[3]` float32 in [-1, 1]; the reward is 1 on success, and `info`
    has `success`, `out_of_bounds` and the contacts as Python bools. `modpush/Push-v0` has the paper's
    observation and reward instead.

    Args:
        render_mode: None, or `"rgb_array"` for a drawn top view, which needs no renderer.
        **kwargs: Further arguments of `PushEnv`, without `num_envs`.

    Raises:
        TypeError: For unknown arguments; the message lists the known ones.
        ValueError: For `num_envs`, and for values out of range.
    """

    def __init__(self, render_mode: str | None = None, **kwargs: Any) -> None:
        check_arguments("PushGymEnv", "ClutterPushState-v1", render_mode, kwargs)
        yaw, joint = math.pi + 1e-6, 2 * math.pi + 0.1
        high = np.array([2, 2, yaw, 2, 2, 2, 2, yaw, *[joint] * 6, 1, 1, 1], dtype=np.float32)
        low = -high
        low[-3:] = 0
        self._bounds = (low, high)
        space = spaces.Box(low, high, dtype=np.float32)
        super().__init__(PushEnv(1, **{"depth": None, **kwargs}), space, render_mode)

    def _observation(self, state: TensorDictBase) -> NDArray[np.float32]:
        values = torch.cat([state[key][0].float() for key in OBSERVATION_KEYS]).cpu().numpy()
        return np.clip(values, *self._bounds)
