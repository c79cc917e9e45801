"""What a policy depends on in its environment, as plain data that can be compared."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from torchrl.envs import EnvBase, TransformedEnv

from modpush._hash import weights_hash
from modpush.encoders.encode import Encode
from modpush.encoders.window_transform import EgocentricWindow
from modpush.mdp.action_frame import ActionFrame
from modpush.mdp.mirrored_observation import MirroredObservation
from modpush.mdp.observation_layout import fingerprint_differences as observation_differences
from modpush.mdp.push_observation import PushObservation
from modpush.mdp.push_reward import PushReward
from modpush.planners.subgoals import PlannerSubgoals

__all__ = ["environment_fingerprint", "fingerprint_differences"]


def environment_fingerprint(env: EnvBase) -> dict[str, Any]:
    """What a policy of this environment depends on: entries, frames, encoder, and the reward.

    Args:
        env: An environment with the transforms that `make_push_env` stacks; missing ones are left
            out.

    Returns:
        Plain data, ready for JSON: `observation` (frame, and name, columns, scale and shift of each
        entry), `action_frame`, `subgoals`, `window`, `encoder` (class and hash of its weights) and
        `reward`.
    """
    _ = env.observation_spec  # lays the observation out
    found: dict[str, Any] = {}
    for transform in env.transform if isinstance(env, TransformedEnv) else ():
        match transform:
            case MirroredObservation():
                pass  # for training alone
            case PushObservation():
                found["observation"] = transform.fingerprint()
            case ActionFrame():
                found["action_frame"] = transform.frame
            case EgocentricWindow():
                found["window"] = {
                    "frame": transform.frame,
                    "size": transform.size,
                    "metres_per_pixel": transform.metres_per_pixel,
                    "outside": transform.outside,
                    "max_height": transform.max_height,
                    "upright": transform.upright,
                }
            case PlannerSubgoals():
                where = "fraction" if transform.mode == "fraction" else "lookahead"
                found["subgoals"] = {
                    "mode": transform.mode,
                    where: getattr(transform, where),
                    "lags": list(transform.lags),
                    "ahead": list(transform.ahead),
                }
            case Encode():
                encoder = transform.encoder
                found["encoder"] = {
                    "class": f"{type(encoder).__module__}:{type(encoder).__qualname__}",
                    "weights": weights_hash(encoder),
                }
            case PushReward():
                found["reward"] = {**asdict(transform.config), "terms": sorted(transform.terms)}
    return found


def fingerprint_differences(stored: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """What differs between two fingerprints, in words; empty where nothing does.

    What older files do not say yet is not compared: the sub-goals, and whether the window is upright and
    how large its pixels are.
    """
    found = []
    for name in dict.fromkeys((*stored, *now)):
        a, b = stored.get(name), now.get(name)
        if name == "reward" and a is not None and b is not None:
            a = {"clip": True, **a}  # older files do not say it, and theirs was clipped
        if name == "observation" and a is not None and b is not None:
            try:
                found += [f"observation, {text}" for text in observation_differences(a, b)]
            except (AttributeError, LookupError, TypeError):  # a file may hold anything
                found.append(f"observation: trained with {a!r}, this environment has {b!r}")
        elif name == "subgoals" and (a is None or b is None):
            continue
        elif name == "window" and isinstance(a, Mapping) and isinstance(b, Mapping):
            known = a.keys() & b.keys()
            a, b = ({key: one[key] for key in sorted(known)} for one in (a, b))
            found += [f"window: trained with {a!r}, this environment has {b!r}"] if a != b else []
        elif a != b:
            found.append(f"{name}: trained with {a!r}, this environment has {b!r}")
    return found
