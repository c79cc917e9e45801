"""The paper's observation and reward as a plain Gymnasium environment."""

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from tensordict import TensorDictBase

from modpush._validation import from_plain
from modpush.envs.gym_env import SingleSceneEnv, check_arguments
from modpush.mdp.push_observation import PushObservation
from modpush.recipes.config import END_TO_END, PushEnvConfig
from modpush.recipes.make_env import make_push_env

_BOUND = 100.0
"""Gymnasium warns of infinite spaces; no entry of the library comes near this."""


class PaperGymEnv(SingleSceneEnv):
    """One scene with planner, encoder, observation and reward: `gymnasium.make("modpush/Push-v0")`.

    The observation is that of `make_push_env`, `[n]` float32 of order 1, clipped at 100; `columns` says
    where each entry stands in it. The action is `[3]` float32 in [-1, 1] in the agent's frame; the reward
    is the paper's weighted sum. `info` has `success` (also as `is_success`), `out_of_bounds` and the
    contacts as Python bools.

    Args:
        preset: `"cpu"`, on which the shipped agents' are based, `"paper"` or `"authors"`, see
            `PushEnvConfig.preset`.
        config: The whole configuration instead of a preset; also as plain data, as an EnvSpec holds it.
        render_mode: None, or `"rgb_array"` for a drawn top view, which needs no renderer.
        **options: Further arguments of `make_push_env`: fields to set differently (`scene="slot"`,
            `encoder="rays"`, `difficulty=0.5`, ...), and parts as objects.

    Raises:
        TypeError: For unknown arguments; the message lists the known ones.
        ValueError: For `num_envs`, an unknown preset, and values out of range.
    """

    def __init__(
        self,
        preset: Literal["cpu", "paper", "authors"] = "cpu",
        render_mode: str | None = None,
        config: PushEnvConfig | Mapping[str, Any] | None = None,
        **options: Any,
    ) -> None:
        check_arguments("modpush/Push-v0", render_mode, options)
        if isinstance(config, Mapping):
            config = from_plain(PushEnvConfig, config)
        config = config or PushEnvConfig.preset(preset)
        if options.get("encoder", config.encoder) == END_TO_END:
            raise ValueError(
                f"PaperGymEnv: encoder={END_TO_END!r} has an image beside the observation, which "
                "one flat space cannot hold; use make_push_env."
            )
        env = make_push_env(config, num_envs=1, **options)
        width = env.observation_spec["observation"].shape[-1]
        space = spaces.Box(-_BOUND, _BOUND, (width,), dtype=np.float32)
        super().__init__(env, space, render_mode)

    @property
    def columns(self) -> dict[str, slice]:
        """The columns of each entry in the observation, by name."""
        (observation,) = [t for t in self.env.transform if isinstance(t, PushObservation)]
        return observation.columns

    def _observation(self, state: TensorDictBase) -> NDArray[np.float32]:
        return np.clip(state["observation"][0].cpu().numpy(), -_BOUND, _BOUND)
