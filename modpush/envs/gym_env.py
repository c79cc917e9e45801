"""One scene for Gymnasium, and its state as an observation, for instance for Stable-Baselines3."""

import math
from abc import ABC, abstractmethod
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from tensordict import TensorDictBase
from torchrl.envs import EnvBase
from torchrl.envs.utils import step_mdp

from modpush._types import Seed
from modpush._validation import check_value
from modpush.envs.push_env import PushEnv
from modpush.envs.specs import ACTION_SIZE

OBSERVATION_KEYS = (
    "object_pose",
    "goal_position",
    "ee_pose",
    "joint_position",
    "object_contact",
    "obstacle_contact",
    "tool_obstacle_contact",
)
"""Keys of `PushEnv` that make up the observation: 3 + 2 + 3 + n + 1 + 1 + 1 numbers for n joints. With
`goal="pose"`, `goal_pose` takes the place of `goal_position`."""
_INFO_KEYS = (
    "success",
    "out_of_bounds",
    "object_contact",
    "obstacle_contact",
    "tool_obstacle_contact",
)


class SingleSceneEnv(gymnasium.Env[NDArray[np.float32], NDArray[np.float32]], ABC):
    """Implement `_observation(state) -> [n] float32`; the rest follows from a TorchRL environment.

    Args:
        env: A `PushEnv` of one scene, or one with transforms on top.
        observation_space: Space of the observation.
        render_mode: None, or `"rgb_array"` for a drawn top view, which needs no renderer.

    Raises:
        ValueError: If the render mode is unknown.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 15}  # noqa: RUF012 (Gymnasium's form)

    def __init__(
        self, env: EnvBase, observation_space: spaces.Box, render_mode: str | None
    ) -> None:
        self.env, self.render_mode = env, render_mode
        self.observation_space = observation_space  # type: ignore[assignment]  # a Box of float32
        self.action_space = spaces.Box(-1.0, 1.0, (ACTION_SIZE,), dtype=np.float32)
        self._state: TensorDictBase | None = None

    @abstractmethod
    def _observation(self, state: TensorDictBase) -> NDArray[np.float32]:
        """The observation, `[n]`, of what the environment emits, batch size `[1]`."""

    @property
    def simulator(self) -> PushEnv:
        """The `PushEnv` without the transforms."""
        return self.env if isinstance(self.env, PushEnv) else self.env.base_env

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Start an episode.

        Args:
            seed: Restarts the random numbers that episodes are drawn with.
            options: May have `scenario`, a `Scenario` to start from instead of drawing it.

        Raises:
            ValueError: For unknown options.
        """
        check_value("seed", seed, Seed | None)
        check_value("options", options, dict[str, Any] | None)
        super().reset(seed=None if seed is None else int(seed))
        options = options or {}
        if unknown := sorted(set(options) - {"scenario"}):
            raise ValueError(f"unknown options {unknown}, expected ['scenario'] or none.")
        scenario = options.get("scenario")
        state = self.env.reset(seed=seed, scenarios=None if scenario is None else [scenario])
        self._state = state
        return self._observation(state), _info(state)

    @torch.no_grad()
    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Take one control step, as `gymnasium.Env.step` does."""
        row = torch.as_tensor(np.asarray(action, dtype=np.float32))
        if row.shape != (ACTION_SIZE,):
            raise ValueError(f"action must be [{ACTION_SIZE}], got {tuple(row.shape)}.")
        if self._state is None:
            raise RuntimeError("call reset first.")
        stepped = self.env.step(self._state.set("action", row[None]))
        after = stepped["next"]
        self._state = step_mdp(stepped)
        return (
            self._observation(after),
            float(after["reward"]),
            bool(after["terminated"]),
            bool(after["truncated"]),
            _info(after),
        )

    def render(self) -> NDArray[np.uint8] | None:
        """The drawn top view, `[H, W, 3]` uint8, or None without a render mode or an episode."""
        if self.render_mode is None or self._state is None:
            return None
        return self.simulator.render()

    def close(self) -> None:
        """Free the simulator."""
        self.env.close(raise_if_closed=False)


def check_arguments(env_id: str, render_mode: str | None, options: dict[str, Any]) -> None:
    """Refuse a render mode that is not there, and a batch of scenes.

    Raises:
        ValueError: With what to do instead.
    """
    if render_mode not in (None, "rgb_array"):
        raise ValueError(f"render_mode must be None or 'rgb_array', got {render_mode!r}.")
    if "num_envs" in options:
        raise ValueError(
            f"it has one scene, got num_envs={options['num_envs']}; for several use "
            f"gymnasium.make_vec({env_id!r}, num_envs=...) or modpush.envs.PushEnv."
        )


def _info(state: TensorDictBase) -> dict[str, Any]:
    """Success, contacts and end of the episode as Python's bools; `is_success` as SB3 names it."""
    return {key: bool(state[key]) for key in _INFO_KEYS} | {"is_success": bool(state["success"])}


class PushGymEnv(SingleSceneEnv):
    """One scene of `PushEnv`, as `gymnasium.make("ClutterPushState-v1")`.

    The observation is the state without the obstacles, `[17]` float32 with six joints, in the order of
    `OBSERVATION_KEYS`, or `[18]` for goal poses; the action is `[3]` float32 in [-1, 1]; the reward is 1
    on success, and `info` has `success`, `out_of_bounds` and the contacts as Python bools.
    `modpush/Push-v0` has the paper's observation and reward instead.

    Args:
        render_mode: None, or `"rgb_array"` for a drawn top view, which needs no renderer.
        **kwargs: Further arguments of `PushEnv`, without `num_envs`.

    Raises:
        TypeError: For unknown arguments; the message lists the known ones.
        ValueError: For `num_envs`, and for values out of range.
    """

    def __init__(self, render_mode: str | None = None, **kwargs: Any) -> None:
        check_arguments("ClutterPushState-v1", render_mode, kwargs)
        env = PushEnv(1, **{"depth": None, **kwargs})
        yaw, joint = math.pi + 1e-6, 2 * math.pi + 0.1
        joints = [joint] * len(env.robot.joints)
        poses = env.simulation.goal == "pose"
        goal = [2, 2, yaw] if poses else [2, 2]
        high = np.array([2, 2, yaw, *goal, 2, 2, yaw, *joints, 1, 1, 1], dtype=np.float32)
        low = -high
        low[-3:] = 0
        self._bounds = (low, high)
        self._keys = [
            "goal_pose" if poses and key == "goal_position" else key for key in OBSERVATION_KEYS
        ]
        super().__init__(env, spaces.Box(low, high, dtype=np.float32), render_mode)

    def _observation(self, state: TensorDictBase) -> NDArray[np.float32]:
        values = torch.cat([state[key][0].float() for key in self._keys]).cpu().numpy()
        return np.clip(values, *self._bounds)
