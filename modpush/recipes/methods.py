"""The policies that the command line knows by name, each with the environment that it needs."""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from tensordict import NestedKey, TensorDictBase
from torchrl.envs import Compose, EnvBase, InitTracker, RenameTransform, TransformedEnv

from modpush._validation import checked_arguments
from modpush.agents import PushingCorridorController, ScriptedPusher, faithful_config
from modpush.envs import PushEnv
from modpush.envs.scenes.conditions import EpisodeConditions, SensingConfig
from modpush.mdp import StuckRecovery, recovering
from modpush.parts import find_part, part_module
from modpush.planners import DistanceField, OccupancyGrid, PlannerSubgoals
from modpush.recipes.agent_file import BEST_AGENT, load_agent, shipped_agents
from modpush.recipes.served import ServedPolicy, is_served

METHODS = {
    "agent": "the shipped agent for all objects, `any_object`",
    "corridor": "the pushing-corridor controller of Krivic and Piater",
    "corridor_faithful": "the same, by the rules of its authors' code",
    "scripted": "a simple pusher along the planner's sub-goals",
}
"""Description of each method, by name."""
_MAX_WAYPOINTS = 32


@dataclass(frozen=True, kw_only=True)
class Method:
    """A policy, the environment that it needs, and where it writes what it plans."""

    name: str
    """Name for tables, pictures and folders: of a run its folder's, of an agent's file that of its folder
    and its own (`train_last_agent`)."""
    make_policy: Callable[[], Callable[[TensorDictBase], TensorDictBase]]
    """Makes the policy."""
    make_env: Callable[..., EnvBase]
    """`(number of scenes, names of the objects, conditions=None, **options of PushEnv) -> environment`;
    picklable. `conditions` are the `EpisodeConditions` of a set; by default the environment's own. With
    `keep_images=True` it emits the depth image and the map."""
    path_key: NestedKey
    """Key of the planned path, `[B, n, 2]` [m], in what a step returns."""
    target_key: NestedKey
    """Key of the sub-goal that is acted upon, `[B, 2]` [m], in what a step returns."""


@checked_arguments
def get_method(
    policy: str | Callable[[TensorDictBase], TensorDictBase],
    *,
    allow: Sequence[str] = (),
    recovery: bool | None = None,
) -> Method:
    """Look a policy up.

    Args:
        policy: A name in `METHODS`, a shipped agent's name, a training run's folder, an agent's file,
            `"http://host:port"` where a policy is served (`ServedPolicy`), or
            `"module:name"` of your own policy: a function of a tensordict that writes `action`, or a
            `Method`. The function itself is taken, too. Others than agents and a `Method` act in the
            environment of `scripted`.
        allow: Modules from which an agent's file may import its author's own parts.
        recovery: Let `StuckRecovery` take over when the policy has come to rest before the goal.
            None: as the agent's config says, and no for other policies. The name of a method shows if it
            differs from this.

    Raises:
        ValueError: If there is no such policy (the known ones are listed), or if the file is not an
            agent or names modules that are not allowed.
    """
    if not isinstance(policy, str):
        name = getattr(policy, "__name__", type(policy).__name__)
        method, default = _function(name, policy), False
    elif policy in METHODS and policy != "agent":
        method, default = _hand_written(policy), False
    elif is_served(policy):
        served = ServedPolicy(policy)
        method, default = replace(_hand_written("scripted"), name=served.config), False
        method = replace(method, make_policy=functools.partial(ServedPolicy, policy))
    elif part_module(policy) is not None and not Path(policy).exists():
        method, default = _own(policy), False
    else:
        method, default = _trained(policy, allow)
    recovers = default if recovery is None else recovery
    if recovers != default:
        suffix = "+recovery" if recovers else "_without_recovery"
        method = replace(method, name=f"{method.name}{suffix}")
    return _with_recovery(method) if recovers else method


@checked_arguments
def get_methods(
    policies: Sequence[str],
    *,
    allow: Sequence[str] = (),
    recovery: bool | None = None,
) -> list[Method]:
    """Look several policies up as `get_method` does, to tell their results apart by their names.

    Raises:
        ValueError: As `get_method`; or if two of them have the same name.
    """
    methods: dict[str, tuple[str, Method]] = {}
    for policy in policies:
        method = get_method(policy, allow=allow, recovery=recovery)
        if method.name in methods:
            raise ValueError(
                f"policy: {methods[method.name][0]!r} and {policy!r} are both called {method.name!r}, by "
                "which results are kept; expected different names, so rename a file or folder."
            )
        methods[method.name] = policy, method
    return [method for _, method in methods.values()]


def _hand_written(policy: str) -> Method:
    if policy in ("corridor", "corridor_faithful"):
        config = faithful_config() if policy == "corridor_faithful" else None
        return Method(
            name=policy,
            make_policy=functools.partial(PushingCorridorController, config),
            make_env=functools.partial(_plain_env, planner=False),
            path_key=("next", "corridor", "path"),
            target_key=("next", "corridor", "target"),
        )
    return Method(
        name=policy,
        make_policy=functools.partial(ScriptedPusher, target_key="subgoal"),
        make_env=functools.partial(_plain_env, planner=True),
        path_key="path",
        target_key="subgoal",
    )


def _own(policy: str) -> Method:
    """A policy, or a method, that is imported."""
    found = find_part("policy", policy, METHODS)
    if isinstance(found, Method):
        return found
    if not callable(found):
        raise ValueError(
            f"policy: {policy!r} must be a function of a tensordict or a Method, got {found!r}."
        )
    return _function(policy.rpartition(":")[2], found)


def _function(name: str, policy: Callable[[TensorDictBase], TensorDictBase]) -> Method:
    """A function, in the environment of `scripted`."""
    return replace(_hand_written("scripted"), name=name, make_policy=lambda: policy)


def _trained(policy: str, allow: Sequence[str]) -> tuple[Method, bool]:
    """An agent without recovery; True if its config has one."""
    name, source = _find_agent(policy)
    agent = load_agent(source, allow=allow)
    method = Method(
        name=name,
        make_policy=lambda: agent.actor,
        make_env=functools.partial(_agent_env, agent=source, allow=tuple(allow)),
        path_key="path",
        target_key="subgoal",
    )
    return method, agent.config.recovery


def _with_recovery(method: Method) -> Method:
    return replace(
        method,
        make_policy=lambda: recovering(method.make_policy()),
        make_env=functools.partial(method.make_env, recovery=True),
    )


def _find_agent(policy: str) -> tuple[str, str]:
    """Name and file of an agent. A run's files are called alike, so that the folder is in the name."""
    path = Path(policy)
    if policy == "agent":
        return policy, "any_object"
    if policy in shipped_agents():
        return policy, policy
    if (path / BEST_AGENT).is_file():
        return path.resolve().name, policy
    if path.is_file():
        return f"{path.resolve().parent.name}_{path.stem}", policy
    raise ValueError(
        f"policy: no {policy!r}, expected {', '.join(METHODS)}, a shipped agent "
        f"({', '.join(shipped_agents())}), a training run's folder, an agent's file, "
        "http://host:port or module:name."
    )


def _plain_env(
    num_envs: int,
    objects: Sequence[str],
    conditions: EpisodeConditions | None = None,
    *,
    planner: bool,
    recovery: bool = False,
    keep_images: bool = True,  # it always does
    **options: Any,
) -> EnvBase:
    """`PushEnv`, with the planner's sub-goals for those that follow them."""
    conditions = conditions or EpisodeConditions()
    if conditions.sensing != SensingConfig():
        raise ValueError(
            "conditions: sensing must be exact for a hand-written policy, since delays and noise are for "
            f"agents, got {conditions.sensing}."
        )
    transforms: list[Any] = [InitTracker()]
    if planner:
        grid = OccupancyGrid(
            object_radius_key="object_radius",
            inscribed_radius_key="object_inscribed_radius",
            inflation=conditions.inflation,
        )
        transforms += [grid, PlannerSubgoals(DistanceField(), max_waypoints=_MAX_WAYPOINTS)]
    elif conditions.inflation == "inscribed":  # the corridor controller's map
        keys = ["object_inscribed_radius"], ["touch_radius"]
        transforms.append(RenameTransform(*keys, create_copy=True))
    options = {**conditions.env_options, **options}
    if recovery:
        transforms.append(StuckRecovery())
    env = PushEnv(num_envs, pushed_object=tuple(objects), **options)
    return TransformedEnv(env, Compose(*transforms))


def _agent_env(
    num_envs: int,
    objects: Sequence[str],
    conditions: EpisodeConditions | None = None,
    *,
    agent: str,
    allow: Sequence[str],
    recovery: bool = False,
    **options: Any,
) -> EnvBase:
    """The environment that an agent was trained in, with the objects of a set."""
    found = load_agent(agent, allow=allow)
    given = {} if conditions is None else conditions.agent_options(found.config.inflation)
    return replace(found, config=replace(found.config, recovery=recovery)).make_env(
        num_envs,
        **{
            "pushed_object": tuple(objects),
            "max_waypoints": _MAX_WAYPOINTS,
            **given,
            **options,
        },
    )
