"""The policies that the page offers, each with the environment that it needs."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from modpush.envs.scenes.objects import OBJECTS
from modpush.viewer.hand import HandPolicy
from modpush.viewer.lane import PolicyLane

if TYPE_CHECKING:
    from modpush.recipes.agent_file import Agent

__all__ = ["POLICIES", "make_lane"]

POLICIES = ("agent", "corridor", "corridor_faithful", "scripted", "hand")
"""Names of the policies; `"agent"` is the shipped one for all objects. A shipped agent's name, an agent's
file or a training run's folder can be given as well."""
_MAX_WAYPOINTS = 32  # of the path that is shown


def make_lane(policy: str) -> PolicyLane:
    """A policy in an environment of one scene that holds all shipped objects.

    Args:
        policy: One of `POLICIES`, an agent's file, or a training run's folder.

    Raises:
        ValueError: If there is no such policy, or the file is not an agent.
    """
    options: dict[str, Any] = {
        "pushed_object": tuple(OBJECTS),
        "max_waypoints": _MAX_WAYPOINTS,
        "max_episode_steps": None,
        "keep_images": True,
    }
    if policy not in POLICIES or policy == "agent":
        agent = _load(policy)
        name = policy if policy == "agent" else Path(policy).stem
        return PolicyLane(name, agent.make_env(1, **options), agent.policy)
    # Here, since the simulator comes with it.
    from modpush.recipes.config import PushEnvConfig
    from modpush.recipes.make_env import make_push_env

    config = PushEnvConfig.preset("cpu", num_envs=1, action_frame="base")
    env = make_push_env(config, **options)
    if policy == "hand":
        return PolicyLane(policy, env, HandPolicy())
    if policy == "scripted":
        from modpush.agents.scripted import ScriptedPusher

        return PolicyLane(policy, env, ScriptedPusher(target_key="subgoal"))
    from modpush.agents.corridor.config import faithful_config
    from modpush.agents.corridor.controller import PushingCorridorController

    controller = PushingCorridorController(
        faithful_config() if policy == "corridor_faithful" else None
    )
    return PolicyLane(
        policy,
        env,
        controller,
        path_key=("next", "corridor", "path"),
        target_key=("next", "corridor", "target"),
    )


def _load(policy: str) -> "Agent":
    from modpush.recipes.agent_file import load_agent, shipped_agents

    if policy == "agent":  # any object may be chosen on the page
        return load_agent("any_object")
    if policy in shipped_agents():
        return load_agent(policy)
    path = Path(policy)
    best = path / "best_agent.safetensors"
    if not path.is_file() and not best.is_file():
        raise ValueError(
            f"policy: no {policy!r}, expected one of {[*POLICIES, *shipped_agents()]}, an agent's "
            "file, or a training run's folder."
        )
    return load_agent(best if best.is_file() else path)
