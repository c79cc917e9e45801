"""The stack of transforms on a `PushEnv` that a configuration describes, in one call."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import torch
from tensordict import NestedKey
from torch import nn
from torchrl.envs import Compose, EnvBase, ExcludeTransform, InitTracker, Transform, TransformedEnv

from modpush._types import Seed
from modpush._validation import checked_arguments
from modpush.encoders.base import encoder_sizes
from modpush.encoders.encode import Encode, make_encoder
from modpush.encoders.networks import ConvEncoder, RayScan
from modpush.encoders.window import METRES_PER_PIXEL
from modpush.encoders.window_transform import EgocentricWindow, WindowBytes
from modpush.envs.push_env import PushEnv
from modpush.envs.robot.control import MotionConfig
from modpush.envs.robot.named import find_tool
from modpush.envs.robot.robot import Robot
from modpush.envs.scenes.conditions import SensingConfig
from modpush.geometry.workspace import Rectangle
from modpush.mdp.action_frame import ActionFrame
from modpush.mdp.contact_filter import ContactFilter
from modpush.mdp.curriculum import Curriculum
from modpush.mdp.curriculum_scenes import CurriculumScenes
from modpush.mdp.entry_list import latent_entry, resolve_entries
from modpush.mdp.observation_entries import ENTRIES, Entry, EntryLike
from modpush.mdp.push_observation import MirroredObservation, PushObservation
from modpush.mdp.push_reward import PushReward
from modpush.mdp.reward_terms import RewardTerm
from modpush.mdp.step_outcome import RewardKeys
from modpush.planners.grid_planner import Planner
from modpush.recipes.config import END_TO_END, PushEnvConfig
from modpush.recipes.planning import (
    TRUE,
    make_history,
    make_planning,
    make_recovery,
    make_sensing,
    observation_keys,
    observed_keys,
)

ENV_PARTS = (
    "encoder",
    "planner",
    "scene",
    "pushed_object",
    "depth",
    "engine",
    "robot",
    "tool",
    "entries",
    "reward_terms",
)
"""Arguments of `make_push_env` that may be given as objects."""

_EXACT = observed_keys(SensingConfig())
"""Keys of the true values."""


def env_parts(config: PushEnvConfig, parts: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments of `make_push_env` among parts; not an encoder that is trained with the agent."""
    trained = {"encoder"} if config.encoder == END_TO_END else set()
    return {kind: part for kind, part in parts.items() if kind in {*ENV_PARTS} - trained}


@checked_arguments
def make_push_env(
    config: PushEnvConfig | None = None,
    *,
    encoder: str | nn.Module | None = None,
    planner: str | Planner | None = None,
    entries: Sequence[EntryLike | tuple[str, EntryLike]] | None = None,
    reward_terms: Mapping[str, RewardTerm | str] | None = None,
    curriculum: Curriculum | None = None,
    evaluated_envs: Sequence[int] | None = None,
    max_waypoints: int = 0,
    keep_images: bool = False,
    mirrored: bool = False,
    pictures: bool = False,
    base: Any = None,
    seed: Seed | None = None,
    device: torch.device | str = "cpu",
    **fields: Any,
) -> EnvBase:
    """The stack of transforms on a `PushEnv` that a configuration describes, batch size `[num_envs]`.

    It emits what `PushEnv` does, without the images, and `path_length`, `subgoal`, `subgoal_past`,
    `path_found` (see `PlannerSubgoals`), `latent` `[B, d]`, `observation` `[B, n]` float32,
    `reward` `[B, 1]` and its terms under `reward_terms`. With `encoder="end_to_end"` it emits `window`
    `[B, 1, S, S]` uint8 instead of `latent`, for networks that encode it themselves. With `plan_poses` it
    emits what `PoseSubgoals` writes as well, with `recovery` what `StuckRecovery` writes, and with the
    entry `history` what `PushHistory` writes.

    With noise or delayed observations (`config.sensing`) the keys of `PushEnv` hold the exact values,
    from which the reward is computed, with the path length `("true", "path_length")`. What the policy's
    observation, plan, window and recovery are computed from is under `("observed", name)`. An entry of
    your own that reads a key of its choice gets the truth.

    Args:
        config: Configuration of the stack; the paper's environment by default.
        encoder: Encoder of the window instead of the config's: a name, `"module:name"`, or
            a module.
        planner: Path planner instead of the config's: a name, `"module:name"`, or an
            object.
        entries: Entries of the observation instead of the config's, see `PushObservation`.
            The encoder's latent of an empty window is subtracted from the entry `"latent"`.
        reward_terms: Your own reward terms by name; give each a weight in `config.reward`.
        curriculum: Curriculum that decides which episodes are drawn.
        evaluated_envs: Scenes whose episodes count for promotion, see `CurriculumScenes`.
        max_waypoints: Number of waypoints of `path`, which is emitted if it is not 0, see
            `PlannerSubgoals`.
        keep_images: Also emit depth, segmentation, occupancy and window.
        mirrored: Also emit `mirrored_observation` `[B, n]`, see `MirroredObservation`.
        pictures: Build the scenes with a renderer, see `PushEnv`.
        base: Environment to stack the transforms on instead of a `PushEnv` of the config, such as one
            that reads a camera: with the keys of `PushEnv`, and its `robot`, `scenario` and `bounds`.
        seed: Seed of the first scene, see `PushEnv`.
        device: Device of the environment, see `PushEnv`.
        **fields: Fields of the config to set differently, also those of its `scenario`, `simulation`
            and `sensing` (`num_envs=2`, `scene="slot"`, `tool="rod"`, ...; scenes, objects, engine,
            robot, tool and depth camera also as objects of your own).

    Raises:
        TypeError: If an argument is neither this function's nor a field of the config.
        ValueError: If a part is unknown or refuses its settings; with `mirrored`, if an entry cannot be
            mirrored, or observation and action have different frames.
    """
    config = (config or PushEnvConfig()).with_fields(**fields)
    if isinstance(encoder, str) and encoder == END_TO_END:
        config, encoder = replace(config, encoder=END_TO_END), None
    elif encoder is not None and config.encoder == END_TO_END:
        config = replace(config, encoder="none")
    if mirrored and config.action_frame not in (None, config.frame):
        raise ValueError(
            f"make_push_env: mirrored needs actions in the observation's frame {config.frame!r}, got "
            f"action_frame={config.action_frame!r}."
        )
    if base is None:
        base = PushEnv(
            config.num_envs,
            scenario=config.filled_scenario(),
            simulation=config.simulation,
            pictures=pictures,
            seed=seed,
            device=device,
        )
    module = _make_encoder(config, encoder)
    described = _entries(config, entries, module, base.robot)
    observed = observed_keys(config.sensing)
    transforms: list[Transform] = [InitTracker()]
    if curriculum:
        transforms.append(CurriculumScenes(curriculum, evaluated_envs=evaluated_envs))
    transforms += make_sensing(config.sensing)
    planned = config, base.scenario, planner
    if not config.sensing.exact:
        transforms += make_planning(*planned, 0, _EXACT, TRUE)
    transforms += make_planning(*planned, max_waypoints, observed)
    transforms += _window(config, module, mirrored, observed)
    transforms += _actions(config, base.bounds, "history" in described, observed)
    transforms += _observations(config, base.bounds, described, mirrored, observed)
    transforms += _reward(config, reward_terms)
    if not keep_images:
        transforms.append(_without_images(config, module is not None, observed))
    return TransformedEnv(base, Compose(*transforms))


def _actions(
    config: PushEnvConfig, bounds: Rectangle, history: bool, read: Mapping[str, NestedKey]
) -> list[Transform]:
    """The frame of the actions, the filter before it, and the memory of earlier steps behind it."""
    transforms: list[Transform] = []
    if config.contact_filter:
        guard = ContactFilter(
            find_tool(config.simulation.tool).tip_half_extents,
            bounds,
            patrol_area=config.scenario.bounds(0.0),
            max_step=MotionConfig.max_step,
            max_turn=MotionConfig.max_turn,
            step_time=1 / config.simulation.control_freq,
            object_pose_key=read["object_pose"],
            ee_pose_key=read["ee_pose"],
        )
        transforms.append(guard)
    transforms.append(ActionFrame(config.acting_frame, object_pose_key=read["object_pose"]))
    if history:
        transforms.append(make_history(config.acting_frame, read))
    return transforms


def _observations(
    config: PushEnvConfig,
    bounds: Rectangle,
    entries: dict[str, Entry],
    mirrored: bool,
    read: Mapping[str, NestedKey],
) -> list[Transform]:
    """The observation, and that of the mirrored scene."""
    kinds = (PushObservation, MirroredObservation) if mirrored else (PushObservation,)
    return [
        kind(
            config.frame,
            entries=entries,
            bounds=bounds,
            symmetry=config.symmetry,
            raw=config.raw,
            keys=observation_keys(read, mirrored=kind is MirroredObservation),
        )
        for kind in kinds
    ]


def _reward(config: PushEnvConfig, terms: Mapping[str, RewardTerm | str] | None) -> list[Transform]:
    """The reward, of the true path's length, and the recovery of a tool that is stuck."""
    keys = RewardKeys()
    if not config.sensing.exact:
        lengths = {name: (TRUE, name) for name in ("path_length", "pose_path_length")}
        keys = RewardKeys(**lengths)
    reward = PushReward(config.reward, terms=terms, keys=keys)
    return [reward, make_recovery(config.sensing)] if config.recovery else [reward]


def _without_images(
    config: PushEnvConfig, encoded: bool, read: Mapping[str, NestedKey]
) -> ExcludeTransform:
    """Leaves out images and maps, and the window if it has been encoded."""
    images = [keys[name] for keys in (_EXACT, read) for name in ("depth", "segmentation")]
    maps = ["occupancy"] if config.sensing.exact else ["occupancy", (TRUE, "occupancy")]
    return ExcludeTransform(*dict.fromkeys(images), *maps, *(["window"] if encoded else []))


def _make_encoder(config: PushEnvConfig, given: Any) -> nn.Module | None:
    if given is None and config.encoder == END_TO_END:
        return None
    if given is None and config.encoder == "rays" and config.latent_dim is not None:
        return RayScan(num_rays=config.latent_dim)
    encoder = make_encoder(config.encoder if given is None else given)
    if isinstance(encoder, ConvEncoder) and any(p.requires_grad for p in encoder.parameters()):
        warnings.warn(
            "make_push_env: nothing trains the weights of this ConvEncoder. To train it with the "
            "agent use encoder='end_to_end' and the learner's encoder (TQCConfig.encoder); if it "
            "is trained already, say so with encoder.requires_grad_(False).",
            stacklevel=3,
        )
    return encoder


def _window(
    config: PushEnvConfig,
    encoder: nn.Module | None,
    mirrored: bool,
    read: Mapping[str, NestedKey],
) -> list[Transform]:
    """The local window and its latent; or its bytes, for an encoder that is trained with the agent."""
    if encoder is None and config.encoder != END_TO_END:
        return []
    size, scale = config.window_size, METRES_PER_PIXEL
    if encoder is not None:
        _, size, scale = encoder_sizes(encoder)
    window = EgocentricWindow(
        config.frame,
        size=size,
        outside=config.window_outside,
        metres_per_pixel=scale,
        depth_key=read["depth"],
        segmentation_key=read["segmentation"],
        object_pose_key=read["object_pose"],
    )
    if encoder is None:
        return [window, WindowBytes()]
    return [window, Encode(encoder, mirrored_key="mirrored_latent" if mirrored else None)]


def _entries(
    config: PushEnvConfig,
    given: Sequence[EntryLike | tuple[str, EntryLike]] | None,
    encoder: nn.Module | None,
    robot: Robot,
) -> dict[str, Entry]:
    """The observation's entries, the latent relative to that of an empty window and joints to home.

    Without an encoder the default entries leave out `latent`.
    """
    chosen = given if given is not None else config.entries or None
    entries = resolve_entries(config.frame, chosen, leave_out=config.leave_out, add=config.add)
    if encoder is not None and entries.get("latent") is ENTRIES["latent"]:
        entries["latent"] = latent_entry(encoder)
    joints = ENTRIES["joint_position"]
    if entries.get("joint_position") is joints and robot.home != joints.shift:
        entries["joint_position"] = Entry(joints.read, shift=robot.home)
    if encoder is None and given is None:
        entries.pop("latent", None)
    return entries
