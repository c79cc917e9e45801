"""The stack of `make_push_env` on one scene as a plain Gymnasium environment."""

from collections.abc import Mapping
from typing import Any, Literal

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from tensordict import TensorDictBase
from torchrl.envs.utils import step_mdp

from modpush._types import Seed
from modpush._validation import check_value, from_plain
from modpush.envs.push_env import PushEnv
from modpush.envs.specs import ACTION_SIZE
from modpush.mdp.push_observation import PushObservation
from modpush.recipes.config import END_TO_END, PushEnvConfig
from modpush.recipes.make_env import make_push_env

_BOUND = 100.0
"""Gymnasium warns of infinite spaces; no entry of the library comes near this."""
_INFO_KEYS = (
    "success",
    "out_of_bounds",
    "object_contact",
    "obstacle_contact",
    "tool_obstacle_contact",
)


class PushGymEnv(gymnasium.Env[NDArray[np.float32], NDArray[np.float32]]):
    """One scene with planner, encoder, observation and reward: `gymnasium.make("modpush/Push-v0")`.

    The observation is that of `make_push_env`, `[n]` float32 of order 1, clipped at 100; `columns` says
    where each entry stands in it. The action is `[3]` float32 in [-1, 1] in the agent's frame; the reward
    is the preset's (`RewardConfig`). `info` has `success` (also as `is_success`), `out_of_bounds` and the
    contacts as Python bools.

    Args:
        preset: `"cpu"`, on which the configurations of the shipped agents are based, `"paper"` or
            `"authors"`, see `PushEnvConfig.preset`.
        config: The whole configuration instead of a preset; also as plain data, as an EnvSpec holds it.
        render_mode: None, or `"rgb_array"` for a drawn top view, which needs no renderer.
        **options: Further arguments of `make_push_env`: fields to set differently (`scene="slot"`,
            `encoder="rays"`, `difficulty=0.5`, ...), and parts as objects.

    Raises:
        TypeError: For unknown arguments; the message lists the known ones.
        ValueError: For `num_envs`, an unknown preset, and values out of range.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"]}  # noqa: RUF012 (Gymnasium's form)

    def __init__(
        self,
        preset: Literal["cpu", "paper", "authors"] = "cpu",
        render_mode: str | None = None,
        config: PushEnvConfig | Mapping[str, Any] | None = None,
        **options: Any,
    ) -> None:
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"render_mode must be None or 'rgb_array', got {render_mode!r}.")
        if "num_envs" in options:
            raise ValueError(
                f"it has one scene, got num_envs={options['num_envs']}; for several use "
                "gymnasium.make_vec('modpush/Push-v0', num_envs=...) or modpush.envs.PushEnv."
            )
        if isinstance(config, Mapping):
            config = from_plain(PushEnvConfig, config)
        config = config or PushEnvConfig.preset(preset)
        if options.get("encoder", config.encoder) == END_TO_END:
            raise ValueError(
                f"PushGymEnv: encoder={END_TO_END!r} has an image beside the observation, which "
                "one flat space cannot hold; use make_push_env."
            )
        self.env = make_push_env(config, num_envs=1, **options)
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": self.simulator.simulation.control_freq}
        width = self.env.observation_spec["observation"].shape[-1]
        space = spaces.Box(-_BOUND, _BOUND, (width,), dtype=np.float32)
        self.observation_space = space
        self.action_space = spaces.Box(-1.0, 1.0, (ACTION_SIZE,), dtype=np.float32)
        self._state: TensorDictBase | None = None

    @property
    def simulator(self) -> PushEnv:
        """The `PushEnv` without the transforms."""
        return self.env.base_env

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
        return _observation(state), _info(state)

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
            _observation(after),
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

    @property
    def columns(self) -> dict[str, slice]:
        """The columns of each entry in the observation, by name."""
        (observation,) = [t for t in self.env.transform if isinstance(t, PushObservation)]
        return observation.columns


PaperGymEnv = PushGymEnv
"""The class by its former name, which stored `EnvSpec`s hold."""


def _observation(state: TensorDictBase) -> NDArray[np.float32]:
    return np.clip(state["observation"][0].cpu().numpy(), -_BOUND, _BOUND)


def _info(state: TensorDictBase) -> dict[str, Any]:
    """Success, contacts and end of the episode as Python's bools; `is_success` as SB3 names it."""
    return {key: bool(state[key]) for key in _INFO_KEYS} | {"is_success": bool(state["success"])}
