"""Observations, rewards, curricula, agents and replay, with right arguments."""

import functools
import math
from typing import Any

import torch
from tensordict import TensorDict
from torch import nn
from torchrl.data import Bounded, Composite, Unbounded

from modpush import agents, mdp, planners
from modpush.envs import ScenarioConfig
from modpush.geometry import Camera
from tests.malformed.environments import stack
from tests.malformed.target import BELOW_1, KEYS, NOT_FINITE, UNKNOWN, Target

CAMERA = Camera(height=32, width=32)
KEYS_OF_ENV = {"object_pose_key": "object_pose", "action_key": "action"}


def targets() -> list[Target]:
    """All of them."""
    return [*_transforms(), *_applied(), *_curricula(), *_networks(), *_losses(), *_buffers()]


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
                "add": [("no such",), (3,), ("goal",), 3],
            },
            only=["leave_out", "add"],
            also={"add": ["entries", "entry"], "leave_out": ["leave out"]},
        ),
        Target(
            name="Entry",
            call=mdp.Entry,
            given=lambda: {"read": lambda inputs: inputs.goal, "scale": 1.0, "shift": 0.0},
            bad={"read": [3, None, "goal"], "scale": NOT_FINITE, "shift": NOT_FINITE},
            only=["read"],
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


def _applied() -> list[Target]:
    """Transforms and policies on data that lack something, or hold something else."""
    grid, window = planners.OccupancyGrid(), stack().transform[3]
    occupancy = torch.zeros(2, 1, 256, 256, dtype=torch.bool)

    def full() -> TensorDict:
        return emitted().clone().set("occupancy", occupancy).set("subgoal", torch.ones(2, 2))

    parts: dict[str, tuple[Any, list[str]]] = {
        "OccupancyGrid": (grid, ["depth", "segmentation"]),
        "PlannerSubgoals": (
            planners.PlannerSubgoals("distance_field"),
            ["occupancy", "object_pose", "goal_position"],
        ),
        "EgocentricWindow": (window, ["depth", "segmentation", "object_pose"]),
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
            bad={key: _wrong_entries(key, full()[key]) for key in keys},
            only=keys,
        )
        for name, (part, keys) in parts.items()
    ]


def _wrong_entries(key: str, value: torch.Tensor) -> list[torch.Tensor]:
    wrong = [value[..., :1], value[..., None], value.to(torch.complex64)]
    if key == "depth":
        return [*wrong, value * 1000, value.double(), value[:, :, :9]]
    if key == "occupancy":
        return [*wrong, value.float(), value[:, :, :9]]
    if key == "segmentation":
        return [*wrong[:2], value.float(), value[:, :, :9]]
    return [*wrong, value * math.nan, value + math.inf]


def _curricula() -> list[Target]:
    state = mdp.Curriculum().state_dict()
    return [
        Target(
            name="Curriculum",
            call=mdp.Curriculum,
            given=lambda: {"config": mdp.CurriculumConfig()},
            bad={"config": [3, "config", {}]},
            only=["config"],
        ),
        Target(
            name="Curriculum.scenario",
            call=mdp.Curriculum().scenario,
            given=lambda: {"base": ScenarioConfig()},
            bad={"base": [3, None, {}]},
            only=["base"],
        ),
        Target(
            name="Curriculum.record",
            call=mdp.Curriculum().record,
            given=lambda: {"success": True, "scene": "slot", "evaluated": True},
            bad={"scene": [3, None]},
        ),
        Target(
            name="Curriculum.count_steps",
            call=mdp.Curriculum().count_steps,
            given=lambda: {"steps": 8},
            bad={"steps": [-1, "3", 1.5]},
        ),
        Target(
            name="Curriculum.load_state_dict",
            call=lambda **state: mdp.Curriculum().load_state_dict(state),
            given=lambda: dict(state),
            bad={"phase": [99, -1], "stage": [99, -1], "steps": [-1], "successes": [3, ["a"]]},
        ),
    ]


@functools.cache
def _parts() -> tuple[Any, Any, Any]:
    observation = Composite(observation=Unbounded((6,)))
    action = Bounded(-1.0, 1.0, (2,))
    config = agents.TQCConfig(hidden_sizes=(8,), num_critics=2, num_quantiles=5, batch_size=4)
    return observation, action, agents.make_tqc_from_specs(config, observation, action)


def _networks() -> list[Target]:
    observation, action, _ = _parts()
    config = agents.TQCConfig(hidden_sizes=(8,), num_critics=2, num_quantiles=5)
    actions = [None, Unbounded((2,)), Bounded(-1.0, 1.0, (2, 2)), 3]
    return [
        Target(
            name="make_tqc_from_specs",
            call=agents.make_tqc_from_specs,
            given=lambda: {
                "config": config,
                "observation_spec": observation,
                "action_spec": action,
                "observation_key": "observation",
                "action_key": "action",
                "loss": "tqc",
                "actor": "mlp",
                "critic": "mlp",
            },
            bad={
                "config": [None, {}, 3],
                "observation_spec": [
                    None,
                    3,
                    Composite(),
                    Composite(observation=Unbounded((2, 3))),
                ],
                "action_spec": actions,
                "observation_key": [*KEYS, "no such"],
                "action_key": KEYS,
                "loss": UNKNOWN[1:],
                "actor": UNKNOWN[1:],
                "critic": UNKNOWN[1:],
            },
            only=["config", "observation_spec", "action_spec"],
            also={"observation_spec": ["observation"]},
        ),
        Target(
            name="make_actor",
            call=agents.make_actor,
            given=lambda: {
                "observation_dim": 6,
                "action_spec": action,
                "hidden_sizes": (8,),
                "observation_key": "observation",
            },
            bad={
                "observation_dim": BELOW_1,
                "hidden_sizes": [(0,), (-1,), (1.5,), "8", 3],
                "action_spec": actions,
                "observation_key": KEYS,
            },
            only=["action_spec"],
        ),
        Target(
            name="make_critic",
            call=agents.make_critic,
            given=lambda: {
                "observation_dim": 6,
                "action_dim": 2,
                "num_quantiles": 5,
                "hidden_sizes": (8,),
                "layer_norm": False,
                "latent_dim": 0,
            },
            bad={
                "observation_dim": BELOW_1,
                "action_dim": BELOW_1,
                "num_quantiles": BELOW_1,
                "hidden_sizes": [(0,), (-1,), (1.5,), "8", 3],
                "latent_dim": [-1],
            },
        ),
        Target(
            name="TQCUpdate",
            call=lambda execution: agents.TQCUpdate(
                _parts()[2].loss, _parts()[2].optimizer, None, execution=execution
            ),
            given=lambda: {"execution": "eager"},
            bad={"execution": [*UNKNOWN, "cudagraph"]},
        ),
    ]


def _batch() -> dict[str, Any]:
    flags = torch.zeros(4, 1, dtype=torch.bool)
    following = {"observation": torch.rand(4, 6), "reward": torch.rand(4, 1), "done": flags}
    now = {"observation": torch.rand(4, 6), "action": torch.rand(4, 2)}
    return {**now, "next": {**following, "terminated": flags.clone()}}


def _losses() -> list[Target]:
    agent = _parts()[2]
    return [
        Target(
            name="TQCLoss.forward",
            call=lambda **batch: agent.loss(TensorDict(batch, [4])),
            given=_batch,
            bad={
                "observation": [torch.rand(4, 5), torch.full((4, 6), math.nan)],
                "action": [torch.rand(4, 3), torch.full((4, 2), math.nan)],
                "next": [
                    {},
                    {k: v for k, v in _batch()["next"].items() if k != "reward"},
                    {**_batch()["next"], "reward": torch.full((4, 1), math.nan)},
                    {**_batch()["next"], "observation": torch.rand(4, 5)},
                ],
            },
            only=["observation", "action", "next"],
            also={"next": ["reward", "observation", "terminated"]},
        ),
        Target(
            name="TQCLoss.make_value_estimator",
            call=lambda **given: agent.loss.make_value_estimator(**given),
            given=lambda: {"value_type": None, "gamma": 0.9},
            bad={"value_type": ["no such", 3, nn.Linear], "gamma": [-0.1, 1.1, math.nan]},
            only=["value_type"],
            also={"value_type": ["value estimator"]},
        ),
    ]


def _buffers() -> list[Target]:
    from tests.malformed.buffers import buffer_targets

    return buffer_targets()
