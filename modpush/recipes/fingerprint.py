"""Fingerprint of an environment: all that a policy depends on, as plain data."""

from collections.abc import Mapping
from typing import Any

from torchrl.envs import EnvBase, TransformedEnv

from modpush._transforms import DescribedTransform
from modpush.mdp.observation_layout import fingerprint_differences as observation_differences

_FIRST_ROBOT = "ur5"  # the only one that older files know, which do not tell it
_SEEN_BY_POLICY = (
    "observation",
    "action_frame",
    "subgoals",
    "pose_subgoals",
    "window",
    "encoder",
    "reward",
)


def describe_transforms(env: EnvBase) -> dict[str, Any]:
    """The settings of an environment's transforms, as each describes itself, by the names they give."""
    _ = env.observation_spec  # lays the observation out
    found: dict[str, Any] = {}
    for transform in env.transform if isinstance(env, TransformedEnv) else ():
        if isinstance(transform, DescribedTransform):
            found |= transform.describe()
    return found


def environment_fingerprint(env: EnvBase) -> dict[str, Any]:
    """Fingerprint of an environment: entries, frames, encoder, and the reward.

    Args:
        env: An environment with the transforms that `make_push_env` stacks; missing ones are left
            out.

    Returns:
        Plain data, ready for JSON: `engine`, `robot`, `observation` (frame, and name, columns, scale and
        shift of each entry), `action_frame`, `subgoals` (without the planner), `pose_subgoals`, `window`,
        `encoder` (class and hash of its weights) and `reward`.
    """
    described = describe_transforms(env)
    found = {name: described[name] for name in _SEEN_BY_POLICY if name in described}
    if engine := getattr(env, "engine_name", None):
        found = {"engine": engine, **found}
    if robot := getattr(env, "robot", None):
        found = {"robot": robot.name, **found}
    if "subgoals" in found:  # a policy may follow the paths of another planner
        found["subgoals"] = {k: v for k, v in found["subgoals"].items() if k != "planner"}
    return found


def fingerprint_differences(stored: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """The differences of two fingerprints, in words; empty where there are none.

    The engine may be another one: a policy sees the same entries in every engine. So may the robot,
    unless the policy observes the angles of its joints.
    Of settings that both have under a name, those that one of them does not know are not compared: an
    older file does not know them all.
    """
    found = []
    stored, now = ({"robot": _FIRST_ROBOT, **one} for one in (stored, now))
    for name in dict.fromkeys((*stored, *now)):
        a, b = stored.get(name), now.get(name)
        if name == "engine" or (name == "robot" and not _observes_joints(stored)):
            continue
        if name == "observation" and a is not None and b is not None:
            try:
                found += [f"observation, {text}" for text in observation_differences(a, b)]
            except (AttributeError, LookupError, TypeError):  # a file may hold anything
                found.append(f"observation: trained with {a!r}, this environment has {b!r}")
            continue
        if isinstance(a, Mapping) and isinstance(b, Mapping):
            known = sorted(a.keys() & b.keys())
            a, b = ({key: one[key] for key in known} for one in (a, b))
        elif name == "subgoals" and a is None:
            continue
        if a != b:
            found.append(f"{name}: trained with {a!r}, this environment has {b!r}")
    return found


def _observes_joints(fingerprint: Mapping[str, Any]) -> bool:
    try:
        return "joint_position" in [e["name"] for e in fingerprint["observation"]["entries"]]
    except (LookupError, TypeError):  # a file may hold anything
        return False
