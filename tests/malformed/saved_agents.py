"""Agents that are saved, exported and published, with right arguments."""

from typing import Any

from torch import nn

from modpush import recipes, training
from modpush.agents import make_actor
from modpush.export import ObservationPolicy, export_agent
from tests.malformed.files import folder, good
from tests.malformed.target import BELOW_1, UNKNOWN, Target


def targets() -> list[Target]:
    """All of them."""
    return [*_agents(), *_hub()]


def _agents() -> list[Target]:
    agent = recipes.load_agent("small_cube")
    actor = make_actor(54, agent.actor.spec["action"], (8,))
    place = folder() / "saved.safetensors"
    return [
        Target(
            name="save_agent",
            call=recipes.save_agent,
            given=lambda: {
                "path": place,
                "policy": actor,
                "config": recipes.PushEnvConfig(),
                "hidden_sizes": (8,),
                "observation_dim": 54,
                "fingerprint": {},
                "metadata": {},
            },
            bad={
                "path": [folder(), good("agent") / "x", 3],
                "policy": [None, 3],
                "config": [None, {}, 3],
                "hidden_sizes": [(0,), ("a",), 3],
                "observation_dim": BELOW_1,
                "fingerprint": [3, None, {"a": object()}],
                "metadata": [3, {"a": object()}],
            },
            only=["policy", "config", "fingerprint", "metadata"],
            also={"path": ["agent.safetensors"]},  # the file that is no folder
        ),
        Target(
            name="Agent.make_env",
            call=lambda **given: agent.make_env(**given).close(),
            given=lambda: {"num_envs": 1, "max_waypoints": 4},
            bad={"num_envs": BELOW_1, "max_waypoints": [-1, 1]},
        ),
        Target(
            name="export_agent",
            call=export_agent,
            given=lambda: {"agent": agent, "folder": folder(), "formats": ("onnx",)},
            bad={
                "agent": [None, 3, "small_cube"],
                "folder": [good("agent"), 3],
                "formats": [(), ("tensorrt",), 3, "onnx"],
            },
            only=["agent", "folder", "formats"],
            also={"folder": ["agent.safetensors"]},
        ),
        Target(
            name="held_out_scenarios",
            call=training.held_out_scenarios,
            given=lambda: {"config": training.TrainConfig(evaluation_episodes=1)},
            bad={"config": [None, 3, {}]},
            only=["config"],
        ),
    ]


def _hub() -> list[Target]:
    agent = recipes.load_agent("small_cube")
    given = {"agent": agent, "repository": "owner/name", "licence": "mit"}
    wrong: dict[str, list[Any]] = {
        "agent": [None, 3, "small_cube", agent.policy],
        "repository": ["", "name", "a/b/c", "hf://a/b", "a/b@main", "a b/c", 3, None],
        "licence": ["", 3, None],
    }
    return [
        Target(
            name="model_card",
            call=recipes.model_card,
            given=lambda: dict(given),
            bad={**wrong, "repository": ["", 3, None]},
            only=list(wrong),
        ),
        Target(
            name="push_to_hub",  # refused before anything is sent
            call=recipes.push_to_hub,
            given=lambda: {**given, "card": None, "private": False, "message": "m", "token": None},
            bad={
                **wrong,
                "card": [3, ("a",)],
                "private": ["yes", 2, None],
                "message": ["", 3, None],
                "token": [3, ("a",)],
            },
            only=[*wrong, "card", "private", "message", "token"],
        ),
        Target(
            name="load_agent(hub)",
            call=lambda name: recipes.load_agent(name),
            given=lambda: {"name": "small_cube"},
            bad={"name": ["hf://", "hf://name", "hf://a/b/c", "hf://a/b@", "hf://a b/c"]},
            only=["name"],
        ),
        Target(
            name="get_method(allow)",
            call=recipes.get_method,
            given=lambda: {"policy": "agent", "allow": ()},
            bad={"policy": ["", "no such", 3, None], "allow": ["modpush", 3, (3,)]},
            only=["policy", "allow"],
            also={"policy": ["no such"]},
        ),
        Target(
            name="ObservationPolicy",
            call=ObservationPolicy,
            given=lambda: {"policy": agent.actor},
            bad={"policy": [None, 3, nn.Linear(2, 2), "small_cube"]},
            only=["policy"],
        ),
        Target(
            name="Trainer",
            call=lambda **given: training.Trainer(**given),
            given=lambda: {
                "config": training.TRAIN_PRESETS["smoke"][1],
                "folder": folder() / "trained",
                "resume": False,
                "parts": {},
                "make_env": recipes.make_push_env,
                "start_method": "spawn",
            },
            bad={
                "config": [None, 3, {}, "smoke"],
                "folder": [good("agent"), 3, None],
                "resume": [None, "yes", 2],
                "parts": [3, {"no such": 1}, "planner", {"planner": 3}],
                "make_env": [None, 3, "make"],
                "start_method": UNKNOWN,
            },
            only=["config", "folder", "resume", "parts", "make_env", "start_method"],
            also={"parts": ["part", "planner"], "folder": ["agent.safetensors"]},
        ),
    ]
