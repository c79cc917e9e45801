"""Transforms and policies, made and applied to data, with right arguments."""

import functools
import math
from typing import Any

import torch
from tensordict import TensorDict
from torch import nn

from modpush import agents, mdp, planners
from modpush.geometry import Camera
from tests.malformed.environments import stack
from tests.malformed.target import BELOW_1, KEYS, NOT_FINITE, NOT_POSITIVE, UNKNOWN, Target

CAMERA = Camera(height=32, width=32)

KEYS_OF_ENV = {"object_pose_key": "object_pose", "action_key": "action"}


def targets() -> list[Target]:
    """All of them."""
    return [*_transforms(), *_applied()]


def _transforms() -> list[Target]:
    keys = dict.fromkeys(KEYS_OF_ENV, KEYS)
    return [
        Target(
            name="PushObservation",
            call=mdp.PushObservation,
            given=lambda: {"frame": "path", "entries": ("goal",), "raw": False, **KEYS_OF_ENV},
            bad={
                "frame": UNKNOWN,
                "entries": [(), ("no such",), (3,), (lambda x: x,), ("goal", "goal"), 3],
                **keys,
            },
            only=["entries"],
            also={"entries": ["entry"]},
        ),
        Target(
            name="resolve_entries",
            call=mdp.resolve_entries,
            given=lambda: {"frame": "base", "leave_out": ("goal",), "add": ("edges",)},
            bad={
                "frame": UNKNOWN,
                "leave_out": [("no such",), 3],
                "add": [("no such",), (3,), ("ee_pose",), 3],
            },
            only=["leave_out", "add"],
            also={"add": ["entries", "entry"], "leave_out": ["leave out"]},
        ),
        Target(
            name="Entry",
            call=mdp.Entry,
            given=lambda: {"read": lambda inputs: inputs.goal, "scale": 1.0, "shift": 0.0},
            bad={
                "read": [3, None, "goal"],
                "scale": [*NOT_FINITE, "3", None, ("a",), {}],
                "shift": [*NOT_FINITE, "3", None, ("a",), {}],
            },
            only=["read", "scale", "shift"],
        ),
        Target(
            name="PushReward",
            call=mdp.PushReward,
            given=lambda: {"config": mdp.RewardConfig(), "terms": {}, **KEYS_OF_ENV},
            bad={
                "config": [3, "config", {}, mdp.RewardConfig(weights={"no such": 1.0})],
                "terms": [{"mine": lambda x: x}, {"goal": 3}, 3],
                **keys,
            },
            only=["config", "terms"],
            also={"config": ["weights"], "terms": ["term"]},
        ),
        Target(
            name="ActionFrame",
            call=mdp.ActionFrame,
            given=lambda: {"frame": "path", **KEYS_OF_ENV},
            bad={"frame": UNKNOWN, **keys},
        ),
        Target(
            name="CurriculumScenes",
            call=mdp.CurriculumScenes,
            given=lambda: {
                "curriculum": mdp.Curriculum(),
                "evaluated_envs": (0,),
                "done_key": "done",
            },
            bad={
                "curriculum": [None, 3, mdp.CurriculumConfig()],
                "evaluated_envs": [(-1,), ("a",), 3, (1.5,)],
                "done_key": KEYS,
            },
            only=["curriculum", "evaluated_envs"],
        ),
        Target(
            name="latent_entry",
            call=mdp.latent_entry,
            given=lambda: {"encoder": nn.Identity()},
            bad={"encoder": [None, 3, "vae"]},
            only=["encoder"],
        ),
        Target(
            name="PushingCorridorController",
            call=agents.PushingCorridorController,
            given=lambda: {
                "config": agents.CorridorConfig(),
                "camera": CAMERA,
                "object_radius": 0.03,
                "depth_key": "depth",
            },
            bad={"object_radius": [0.0, -1.0, *NOT_FINITE], "depth_key": KEYS},
        ),
        Target(
            name="DepthNoise",
            call=mdp.DepthNoise,
            given=lambda: {"sigma": 0.002, "dropout": 0.1, "depth_key": "depth"},
            bad={
                "sigma": [-1.0, 200.0, *NOT_FINITE],
                "dropout": [-0.1, 1.1, *NOT_FINITE],
                "depth_key": KEYS,
            },
        ),
        Target(
            name="StuckRecovery",
            call=mdp.StuckRecovery,
            given=lambda: {"patience": 4, "duration": 4, "tolerance": 0.01, "active_key": "on"},
            bad={
                "patience": BELOW_1,
                "duration": BELOW_1,
                "tolerance": NOT_POSITIVE,
                "active_key": KEYS,
            },
        ),
        Target(
            name="recovering",
            call=mdp.recovering,
            given=lambda: {"policy": agents.ScriptedPusher(), "active_key": "on"},
            bad={"policy": [None, 3, "policy", nn.Identity()], "active_key": KEYS},
            only=["policy", "active_key"],
        ),
        Target(
            name="ScriptedPusher",
            call=agents.ScriptedPusher,
            given=lambda: {"config": agents.ScriptedPusherConfig(), "target_key": "subgoal"},
            bad={"target_key": KEYS, "config": [3, {}]},
        ),
    ]


@functools.cache
def emitted() -> TensorDict:
    """What the stack emits, images included."""
    td = stack().base_env.reset()
    depth = torch.full((2, 1, 256, 256), 1.1)
    return td.set("depth", depth).set("segmentation", depth.byte() * 0)


class _Inverse:
    """A transform of actions, called as the others are."""

    def __init__(self, transform: mdp.ActionFrame) -> None:
        self.transform = transform

    def __call__(self, data: TensorDict) -> Any:
        return self.transform.inv(data)


def _applied() -> list[Target]:
    """Transforms and policies on data that lack something, or hold something else."""
    grid, window = planners.OccupancyGrid(), stack().transform[3]
    occupancy = torch.zeros(2, 1, 256, 256, dtype=torch.bool)

    def full() -> TensorDict:
        td = emitted().clone().set("occupancy", occupancy).set("subgoal", torch.ones(2, 2))
        return td.set("action", torch.zeros(2, 3))

    parts: dict[str, tuple[Any, list[str]]] = {
        "OccupancyGrid": (grid, ["depth", "segmentation"]),
        "PlannerSubgoals": (
            planners.PlannerSubgoals("distance_field"),
            ["occupancy", "object_pose", "goal_position"],
        ),
        "EgocentricWindow": (window, ["depth", "segmentation", "object_pose"]),
        "DepthNoise": (mdp.DepthNoise(0.001), ["depth"]),
        "ActionFrame": (_Inverse(mdp.ActionFrame("object")), ["object_pose", "action"]),
        "PushObservation": (
            mdp.PushObservation(entries=["goal", "ee_position"]),
            ["object_pose", "goal_position", "ee_pose"],
        ),
        "ScriptedPusher": (agents.ScriptedPusher(), ["object_pose", "ee_pose", "goal_position"]),
        "PushingCorridorController": (
            agents.PushingCorridorController(),
            ["depth", "segmentation", "object_pose", "goal_position"],
        ),
    }

    def apply(part: Any, data: dict[str, Any]) -> Any:
        return part(TensorDict(data, [2]))

    return [
        Target(
            name=f"{name}(data)",
            call=lambda part=part, keys=keys, **data: apply(
                part, {k: v for k, v in full().items() if k not in keys} | data
            ),
            given=lambda keys=keys: {key: full()[key] for key in keys},
            bad={key: _wrong_entries(name, key, full()[key]) for key in keys},
            only=keys,
            fixed=True,
        )
        for name, (part, keys) in parts.items()
    ]


def _wrong_entries(name: str, key: str, value: torch.Tensor) -> list[torch.Tensor]:
    wrong = [value[..., :1], value[..., None], value.to(torch.complex64)]
    if name == "DepthNoise":  # it takes images of any size
        return [value.double(), value.long(), value.bool(), wrong[2]]
    if key == "depth":
        return [*wrong, value * 1000, value.double(), value[:, :, :9]]
    if key == "occupancy":
        return [*wrong, value.float(), value[:, :, :9]]
    if key == "segmentation":
        return [*wrong[:2], value.float(), value[:, :, :9]]
    if name == "ActionFrame":  # `PushEnv` refuses the action that comes of what is not finite
        return wrong
    return [*wrong, value * math.nan, value + math.inf]
