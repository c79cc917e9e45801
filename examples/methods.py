"""The policies that `evaluate.py` and `demo.py` know, each with the environment that it needs."""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from tensordict.nn import TensorDictModuleBase
from torchrl.envs import Compose, EnvBase, InitTracker, TransformedEnv

import modpush
from modpush.agents import PushingCorridorController, ScriptedPusher, faithful_config
from modpush.envs import PushEnv
from modpush.planners import DistanceField, OccupancyGrid, PlannerSubgoals
from modpush.recipes.agent_file import load_agent, make_push_env


@dataclass(frozen=True, kw_only=True)
class Method:
    """A policy, the environment that it needs, and where to find what it plans."""

    name: str
    """For tables, pictures and folders."""
    make_policy: Callable[[], TensorDictModuleBase]
    make_env: Callable[..., EnvBase]
    """`(number of scenes, names of the objects, **options of PushEnv)`; can be pickled."""
    path_key: Any
    target_key: Any


def plain_env(num_envs: int, objects: Sequence[str], *, planner: bool, **options: Any) -> EnvBase:
    """`PushEnv`, with the planner's sub-goals for those that follow them."""
    transforms: list[Any] = [InitTracker()]
    if planner:
        transforms += [
            OccupancyGrid(object_radius_key="object_radius"),
            PlannerSubgoals(DistanceField(), max_waypoints=32),
        ]
    env = PushEnv(num_envs, pushed_object=tuple(objects), **options)
    return TransformedEnv(env, Compose(*transforms))


def agent_env(num_envs: int, objects: Sequence[str], *, agent: str, **options: Any) -> EnvBase:
    """The environment that an agent was trained in, with the objects of an evaluation set."""
    config = replace(load_agent(agent).config, num_envs=num_envs)
    if len(objects) == 1:
        config = replace(config, pushed_object=objects[0])
    return make_push_env(config, max_waypoints=32, **{"pushed_object": tuple(objects), **options})


def shipped_agent(objects: Sequence[str]) -> str:
    """The agent that is shipped for the objects, or the small cube's where there is none."""
    weights = Path(modpush.__file__).parent / "weights"
    names = {path.stem.removeprefix("agent_") for path in weights.glob("agent_*.safetensors")}
    return objects[0] if len(objects) == 1 and objects[0] in names else "small_cube"


def get_method(policy: str, objects: Sequence[str] = ("small_cube",)) -> Method:
    """Look a policy up.

    Args:
        policy: `corridor`, `corridor_faithful`, `scripted`, `agent` (the one that is shipped for
            the object, else the small cube's), or a training run's folder or an agent's file.
        objects: Names of the objects that will be pushed.

    Raises:
        ValueError: If there is no such policy.
    """
    if policy in ("corridor", "corridor_faithful"):
        config = faithful_config() if policy == "corridor_faithful" else None
        return Method(
            name=policy,
            make_policy=functools.partial(PushingCorridorController, config),
            make_env=functools.partial(plain_env, planner=False),
            path_key=("next", "corridor", "path"),
            target_key=("next", "corridor", "target"),
        )
    if policy == "scripted":
        return Method(
            name=policy,
            make_policy=functools.partial(ScriptedPusher, target_key="subgoal"),
            make_env=functools.partial(plain_env, planner=True),
            path_key="path",
            target_key="subgoal",
        )
    return _agent(policy, objects)


def _agent(policy: str, objects: Sequence[str]) -> Method:
    path = Path(policy)
    known = (
        "corridor, corridor_faithful, scripted, agent, a training run's folder or an agent's file"
    )
    if policy == "agent":
        name, source = "agent", shipped_agent(objects)
        if objects != (source,):
            print(f"agent: none is shipped for {', '.join(objects)}; {source}'s agent is used.")
    elif (path / "best_agent.safetensors").is_file():
        name, source = path.name, str(path / "best_agent.safetensors")
    elif path.is_file():
        name, source = path.stem, policy
    else:
        raise ValueError(f"policy: no {policy!r}, expected {known}.")
    return Method(
        name=name,
        make_policy=lambda: load_agent(source).policy,
        make_env=functools.partial(agent_env, agent=source),
        path_key="path",
        target_key="subgoal",
    )
