"""Curricula, networks and losses, with right arguments."""

import functools
import math
from typing import Any

import torch
from tensordict import TensorDict
from torch import nn
from torchrl.data import Bounded, Composite, Unbounded

from modpush import agents, mdp
from modpush.envs import ScenarioConfig
from tests.malformed.target import BELOW_1, KEYS, UNKNOWN, Target


def targets() -> list[Target]:
    """All of them."""
    return [*_curricula(), *_networks(), *_losses()]


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
            fixed=True,
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
