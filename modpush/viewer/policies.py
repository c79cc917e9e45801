"""The policies that the page offers, each with the environment that it needs."""

from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

from modpush.envs.outcome import Goal
from modpush.envs.scenes.objects import OBJECTS
from modpush.viewer.config import PlayConfig
from modpush.viewer.lane import PolicyLane

if TYPE_CHECKING:
    from modpush.recipes.agent_file import Agent

POLICIES = ("agent", "corridor", "corridor_faithful", "scripted", "hand")
"""Names of the policies; `"agent"` is the shipped one for all objects, or that for goal poses. What
`load_agent` takes can be given as well."""
_MAX_WAYPOINTS = 32  # of the path that is shown


def make_lane(policy: str, config: PlayConfig | None = None) -> PolicyLane:
    """A policy in an environment of one scene that holds all shipped objects.

    Args:
        policy: One of `POLICIES`, or what `load_agent` takes.
        config: Robot, engine, goal, and modules from which an agent's file may import its author's own
            parts.

    Raises:
        ValueError: If there is no such policy, the file is not an agent, or names modules that are not
            allowed.
    """
    config = config or PlayConfig()
    allow = config.allow
    options: dict[str, Any] = {
        "pushed_object": tuple(OBJECTS),
        "max_waypoints": _MAX_WAYPOINTS,
        "max_episode_steps": None,
        "keep_images": True,
        **({} if config.goal == "position" else {"goal": config.goal}),
    }
    options |= {k: v for k in ("engine", "robot") if (v := getattr(config, k)) is not None}
    if policy not in POLICIES or policy == "agent":
        agent = _load(policy, allow, config.goal)
        name = policy if policy == "agent" else Path(policy).stem
        env = agent.make_env(1, **options)
        return PolicyLane(name, env, agent.policy)
    # Here, since the simulator comes with it.
    from modpush.recipes.config import PushEnvConfig
    from modpush.recipes.make_env import make_push_env
    from modpush.recipes.methods import get_method

    env_config = PushEnvConfig.preset("cpu", num_envs=1, action_frame="base")
    env = make_push_env(env_config, **options)
    if policy == "hand":
        return PolicyLane(policy, env, HandPolicy())
    method = get_method(policy)
    keys = {"path_key": method.path_key, "target_key": method.target_key}
    return PolicyLane(policy, env, method.make_policy(), **keys)


def _load(policy: str, allow: Collection[str], goal: Goal) -> "Agent":
    from modpush.recipes.agent_file import BEST_AGENT, HUB_PREFIX, load_agent, shipped_agents

    if policy == "agent":  # any object may be chosen on the page
        return load_agent("any_object" if goal == "position" else "pose")
    path = Path(policy)
    known = policy in shipped_agents() or policy.startswith(HUB_PREFIX)
    if not (known or path.is_file() or (path / BEST_AGENT).is_file()):
        raise ValueError(
            f"policy: no {policy!r}, expected one of {[*POLICIES, *shipped_agents()]}, an agent's "
            "file, a training run's folder, or hf://owner/name."
        )
    return load_agent(policy, allow=allow)


class HandPolicy(TensorDictModuleBase):
    """Takes the action that was last pressed for some steps, then stands still.

    A browser repeats a key that is held about 30 times a second after a first pause of up to half a
    second; a press therefore lasts a few steps.
    """

    in_keys = ["object_pose"]  # noqa: RUF012
    out_keys = ["action"]  # noqa: RUF012

    def __init__(self) -> None:
        super().__init__()
        self._action = (0.0, 0.0, 0.0)
        self._steps_left = 0

    def press(self, action: tuple[float, float, float], steps: int = 5) -> None:
        """Take an action (dx, dy, dyaw) in [-1, 1], base frame, for this many steps."""
        self._action, self._steps_left = action, steps

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the action, `[B, 3]`."""
        pose = tensordict["object_pose"]
        values = self._action if self._steps_left > 0 else (0.0, 0.0, 0.0)
        self._steps_left -= 1
        tensordict["action"] = torch.tensor(values).expand(pose.shape[0], 3).clone()
        return tensordict
