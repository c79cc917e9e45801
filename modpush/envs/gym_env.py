"""The task as a plain Gymnasium environment, for instance for Stable-Baselines3."""

import math
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from tensordict import TensorDict, TensorDictBase

from modpush.envs.push_env import PushEnv
from modpush.envs.robot.ur5_2f85 import ToolName
from modpush.envs.scenes.drawing import draw_top_view

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


class PushGymEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """One scene of `PushEnv`, as `gymnasium.make("ClutterPushState-v1")`.

    The observation is the state, `[17]` float32, in the order of `OBSERVATION_KEYS`; the action is
    `[3]` float32 in [-1, 1]; the reward is 1 on success, and `info` has `success`, `out_of_bounds`
    and the contacts as Python bools.

    Args:
        render_mode: None, or `"rgb_array"` for a drawn top view, which needs no renderer.
        **kwargs: Further arguments of `PushEnv`, without `num_envs`.

    Raises:
        TypeError: For unknown arguments, with the list of those there are.
        ValueError: For `num_envs`, and for values out of range.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 15}  # noqa: RUF012 (Gymnasium's form)

    def __init__(self, render_mode: str | None = None, **kwargs: Any) -> None:
        if render_mode not in (None, "rgb_array"):
            raise ValueError(
                f"PushGymEnv: render_mode must be None or 'rgb_array', got {render_mode!r}."
            )
        if "num_envs" in kwargs:
            raise ValueError(
                f"PushGymEnv: it has one scene, got num_envs={kwargs['num_envs']}; for several use "
                f"gymnasium.make_vec('ClutterPushState-v1', num_envs=...) or modpush.envs.PushEnv."
            )
        self.render_mode = render_mode
        self.env = PushEnv(1, **{"depth": None, **kwargs})
        self._tool: ToolName = kwargs.get("tool", "2f85")
        self._state: TensorDictBase | None = None
        yaw, joint = math.pi + 1e-6, 2 * math.pi + 0.1
        high = np.array([2, 2, yaw, 2, 2, 2, 2, yaw, *[joint] * 6, 1, 1, 1], dtype=np.float32)
        low = -high
        low[-3:] = 0
        self._bounds = (low, high)
        self.observation_space = spaces.Box(low, high, dtype=np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (3,), dtype=np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode.

        Args:
            seed: Restarts the random numbers that episodes are drawn with.
            options: May have `scenario`, a `Scenario` to start from instead of drawing it.

        Raises:
            ValueError: For unknown options.
        """
        super().reset(seed=seed)
        options = options or {}
        if unknown := sorted(set(options) - {"scenario"}):
            raise ValueError(
                f"PushGymEnv.reset: unknown options {unknown}, expected ['scenario'] or none."
            )
        scenario = options.get("scenario")
        state = self.env.reset(seed=seed, scenarios=None if scenario is None else [scenario])
        return self._observation(state), self._info(state)

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """As `gymnasium.Env.step`."""
        row = torch.as_tensor(np.asarray(action, dtype=np.float32))
        if row.shape != (3,):
            raise ValueError(f"PushGymEnv.step: action must be [3], got {tuple(row.shape)}.")
        state = self.env.step(TensorDict({"action": row[None]}, batch_size=[1]))["next"]
        return (
            self._observation(state),
            float(state["reward"]),
            bool(state["terminated"]),
            bool(state["truncated"]),
            self._info(state),
        )

    def _observation(self, state: TensorDictBase) -> np.ndarray:
        self._state = state
        values = torch.cat([state[key][0].float() for key in OBSERVATION_KEYS]).numpy()
        return np.clip(values, *self._bounds)

    @staticmethod
    def _info(state: TensorDictBase) -> dict[str, Any]:
        keys = ("success", "out_of_bounds", *OBSERVATION_KEYS[-3:])
        return {key: bool(state[key]) for key in keys} | {"is_success": bool(state["success"])}

    def render(self) -> np.ndarray | None:
        """The drawn top view, `[H, W, 3]` uint8, or None without a render mode or an episode."""
        if self.render_mode is None or self._state is None:
            return None
        poses = (self._state[key][0].tolist() for key in ("object_pose", "ee_pose"))
        return draw_top_view(
            self.env.scenarios[0], *poses, tool=self._tool, objects=self.env.pushed_objects
        )

    def close(self) -> None:
        """Free the simulator."""
        self.env.close(raise_if_closed=False)
