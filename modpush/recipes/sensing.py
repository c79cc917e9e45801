"""Transforms of delays and noise, and the keys of what a policy observes with them."""

from collections.abc import Mapping
from dataclasses import replace

from tensordict import NestedKey
from torchrl.envs import Transform

from modpush.envs.scenes.sensing import SensingConfig
from modpush.geometry.frames import Frame
from modpush.mdp.delays import ActionDelay, ObservationDelay
from modpush.mdp.noise import PoseNoise
from modpush.mdp.observation_inputs import ObservationKeys
from modpush.mdp.push_history import PushHistory
from modpush.mdp.stuck_recovery import StuckRecovery

__all__ = ["make_history", "make_recovery", "make_sensing", "observation_keys", "observed_keys"]

_MEASURED = (
    "object_pose",
    "ee_pose",
    "joint_position",
    "object_contact",
    "depth",
    "segmentation",
)
_PATIENCE = 4  # of `StuckRecovery`


def observed_keys(sensing: SensingConfig) -> Mapping[str, NestedKey]:
    """Key of each measurement by its own name, `("observed", name)` where it differs from the truth."""
    delayed = sensing.observation_delay[1] > 0
    changed = _MEASURED if delayed else ("object_pose",) if sensing.noisy else ()
    return {name: ("observed", name) if name in changed else name for name in _MEASURED}


def observation_keys(observed: Mapping[str, NestedKey], *, mirrored: bool) -> ObservationKeys:
    """Keys that the entries of the observation read."""
    poses = {name: observed[name] for name in _MEASURED if name not in ("depth", "segmentation")}
    return ObservationKeys(latent="mirrored_latent" if mirrored else "latent", **poses)


def make_sensing(sensing: SensingConfig) -> list[Transform]:
    """Transforms next to `PushEnv`: a pose is measured with its noise, and arrives later."""
    transforms: list[Transform] = []
    if sensing.action_delay[1] > 0:
        transforms.append(ActionDelay(sensing.action_delay))
    if sensing.noisy:
        transforms.append(PoseNoise(sensing.position_noise, sensing.yaw_noise))
    if sensing.observation_delay[1] > 0:
        measured = observed_keys(replace(sensing, observation_delay=(0, 0)))
        delay = ObservationDelay(
            sensing.observation_delay,
            in_keys=[*measured.values()],
            out_keys=[*observed_keys(sensing).values()],
        )
        transforms.append(delay)
    return transforms


def make_history(frame: Frame, observed: Mapping[str, NestedKey]) -> PushHistory:
    """`PushHistory` of what is observed, for actions in these axes."""
    measured = ("object_pose", "ee_pose", "object_contact")
    return PushHistory(frame, **{f"{name}_key": observed[name] for name in measured})


def make_recovery(sensing: SensingConfig) -> StuckRecovery:
    """`StuckRecovery` of what is observed, which waits longer by the largest delays."""
    keys = observed_keys(sensing)
    return StuckRecovery(
        _PATIENCE + sensing.action_delay[1] + sensing.observation_delay[1],
        object_pose_key=keys["object_pose"],
        ee_pose_key=keys["ee_pose"],
    )
