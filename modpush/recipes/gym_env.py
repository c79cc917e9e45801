"""The paper's observation and reward as a plain Gymnasium environment."""

from collections.abc import Mapping
from dataclasses import fields
from typing import Any, Literal

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from tensordict import TensorDictBase

from modpush._validation import from_plain
from modpush.envs.arguments import parameter_names, refuse_unknown
from modpush.envs.push_env import PushEnv
from modpush.envs.scenes.scenario import ScenarioConfig
from modpush.envs.single_scene import SingleSceneEnv, check_arguments
from modpush.mdp.push_observation import PushObservation
from modpush.mdp.push_reward import RewardConfig
from modpush.recipes.config import END_TO_END, PushEnvConfig
from modpush.recipes.make_env import ENV_PARTS, make_push_env

__all__ = ["PaperGymEnv"]

_BOUND = 100.0
"""Gymnasium warns of infinite spaces; no entry of the library comes near this."""
_CONFIG_FIELDS = {field.name for field in fields(PushEnvConfig)} - {"num_envs"}


class PaperGymEnv(SingleSceneEnv):
    """One scene with planner, encoder, observation and reward: `gymnasium.make("modpush/Push-v0")`.

    The observation is that of `make_push_env`, `[n]` float32 of order 1, clipped at 100; `columns` says
    where each entry stands in it. The action is `[3]` float32 in [-1, 1] in the agent's frame; the reward
    is the paper's weighted sum. `info` has `success` (also as `is_success`), `out_of_bounds` and the
    contacts as Python bools.

    Args:
        preset: `"cpu"`, on which the shipped agents' are based, `"paper"` or `"authors"`, see
            `PushEnvConfig.preset`.
        render_mode: None, or `"rgb_array"` for a drawn top view, which needs no renderer.
        **options: Fields of `PushEnvConfig` to set differently (`scene="slot"`, `encoder="rays"`,
            `difficulty=0.5`, ..., `reward` also as a mapping), parts that are given to
            `make_push_env` as objects, or further arguments of `PushEnv`.

    Raises:
        TypeError: For unknown arguments; the message lists the known ones.
        ValueError: For `num_envs`, an unknown preset, and values out of range.
    """

    def __init__(
        self,
        preset: Literal["cpu", "paper", "authors"] = "cpu",
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        check_arguments("PaperGymEnv", "modpush/Push-v0", render_mode, options)
        config, rest = _split("PaperGymEnv", options)
        if isinstance(config.get("reward"), Mapping):  # as an EnvSpec holds it
            config["reward"] = from_plain(RewardConfig, config["reward"])
        if config.get("encoder") == END_TO_END:
            raise ValueError(
                f"PaperGymEnv: encoder={END_TO_END!r} has an image beside the observation, which "
                "one flat space cannot hold; use make_push_env."
            )
        env = make_push_env(PushEnvConfig.preset(preset, num_envs=1, **config), **rest)
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


def _are_names(entries: Any) -> bool:
    """Whether entries of the observation are given by name, as a config has them."""
    return isinstance(entries, list | tuple) and all(isinstance(entry, str) for entry in entries)


def _split(who: str, options: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Options that go into the config, and those that `make_push_env` takes beside it."""
    of_simulator = {*parameter_names(PushEnv.__init__), *(f.name for f in fields(ScenarioConfig))}
    beside = of_simulator | set(ENV_PARTS)
    known = sorted((_CONFIG_FIELDS | beside) - {"num_envs"})
    refuse_unknown(who, set(options) - set(known), f"some of {['preset', 'render_mode', *known]}")
    # `path_margin` is the planner's, as in `PushEnvConfig`; that of the episodes that are drawn, a field
    # of `ScenarioConfig`, has the same name.
    in_config = {
        name: value
        for name, value in options.items()
        if name not in beside
        or name == "path_margin"
        or (name == "encoder" and isinstance(value, str))
        or (name == "entries" and _are_names(value))
    }
    return in_config, {name: v for name, v in options.items() if name not in in_config}
