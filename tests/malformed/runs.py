"""Evaluation, agents on disk, training, export, viewer and the command line, with right arguments."""

import functools
import tempfile
from typing import Any

import pandas as pd
import torch

from modpush import evaluation, recipes, training
from modpush.agents import make_actor
from modpush.cli.demo import DemoConfig
from modpush.cli.evaluate import EvaluateConfig
from modpush.cli.export import ExportConfig
from modpush.cli.train import RunConfig
from modpush.evaluation.results import COLUMNS
from modpush.export import export_agent
from modpush.viewer import PlayConfig, Session
from tests.malformed.files import folder, good
from tests.malformed.target import BELOW_1, NOT_FINITE, UNKNOWN, Target


def targets() -> list[Target]:
    """All of them."""
    return [*_sets(), *_tables(), *_evaluation(), *_agents(), *_viewer(), *_commands()]


def _sets() -> list[Target]:
    smoke = evaluation.load_set("smoke")
    return [
        Target(
            name="EvaluationSet.first",
            call=smoke.first,
            given=lambda: {"count": 2},
            bad={"count": BELOW_1},
        ),
        Target(
            name="generate_set",
            call=evaluation.generate_set,
            given=lambda: {"name": "smoke", "episodes": [0]},
            bad={"name": UNKNOWN, "episodes": [[-1], ["a"], 3, [0.5]]},
            only=["episodes"],
        ),
        Target(
            name="EvaluationSet",
            call=evaluation.EvaluationSet,
            given=lambda: {"name": "mine", "scenarios": smoke.scenarios[:2]},
            bad={"name": ["", "../up", "/abs", ".hidden", "a//b"], "scenarios": [(3,), 3, "abc"]},
        ),
    ]


@functools.cache
def rows() -> pd.DataFrame:
    """Made figures of two episodes."""
    right = dict.fromkeys(COLUMNS, 0.5) | {"scene": "slot", "pushed_object": "small_cube"}
    return pd.DataFrame([right | {"episode": n, "success": True} for n in range(2)])


def _tables() -> list[Target]:
    frames = [None, 3, rows().iloc[:0], rows().drop(columns="success"), "text"]
    changed = rows().assign(episode=[5, 6])
    return [
        Target(
            name="summarize",
            call=evaluation.summarize,
            given=lambda: {"rows": {"a": rows()}},
            bad={
                "rows": [
                    {},
                    3,
                    None,
                    {"a": rows(), "b": changed},
                    {"a": rows(), "b": rows()[:1]},
                    *({"a": frame} for frame in frames),
                ]
            },
            only=["rows"],
            also={"rows": ["method", "methods", "success"]},
        ),
        Target(
            name="compare",
            call=evaluation.compare,
            given=lambda: {"first": rows(), "second": rows(), "level": 0.05},
            bad={"first": [*frames, changed], "second": [*frames, changed], "level": NOT_FINITE},
            only=["first", "second"],
            also={"first": ["success"], "second": ["success"]},
        ),
        Target(
            name="format_table",
            call=evaluation.format_table,
            given=lambda: {"table": rows(), "how": "csv"},
            bad={"how": UNKNOWN, "table": [None, 3, {}]},
            only=["table"],
        ),
        Target(
            name="write_tables",
            call=evaluation.write_tables,
            given=lambda: {"rows": rows(), "folder": folder()},
            bad={"rows": frames, "folder": [good("agent"), 3]},
            only=["rows", "folder"],
            also={"rows": ["success", "method"], "folder": ["agent.safetensors"]},
        ),
    ]


def _evaluation() -> list[Target]:
    from tests.evaluation.conftest import make_env

    def policy(td: Any) -> Any:
        return td.set("action", torch.zeros(*td.batch_size, 3))

    def evaluate(**given: Any) -> Any:
        with tempfile.TemporaryDirectory() as name:
            return evaluation.evaluate(**{"folder": name, **given})

    smoke = evaluation.load_set("free/small_cube").first(1)
    quiet = evaluation.EvaluationConfig(num_envs=1, progress=False)
    right = {
        "policy": policy,
        "evaluation_set": smoke,
        "make_env": make_env,
        "label": "",
        "config": quiet,
        "resume": True,
    }
    return [
        Target(
            name="evaluate",
            call=evaluate,
            given=lambda: dict(right),
            bad={
                "policy": [None, 3, "no such"],
                "evaluation_set": [*UNKNOWN, 3, None, good("agent")],
                "make_env": [None, 3],
                "config": [3, {}],
            },
            only=["policy", "evaluation_set", "make_env", "config"],
            also={"evaluation_set": ["set"]},
        ),
        Target(
            name="EvaluationConfig",
            call=evaluation.EvaluationConfig,
            given=lambda: {"num_envs": 1, "workers": 1, "seed": 0, "path_key": "path"},
            bad={
                "num_envs": [*BELOW_1, 10**9],
                "workers": [*BELOW_1, 10**9],
                "path_key": ["", (), 3],
            },
        ),
    ]


def _agents() -> list[Target]:
    agent = recipes.load_agent("small_cube")
    actor = make_actor(54, agent.policy.spec["action"], (8,))
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


@functools.cache
def session() -> Session:
    """One policy in the free family."""
    return Session(PlayConfig(policy=("hand",), scene="slot"))


def _viewer() -> list[Target]:
    kept = session()
    return [
        Target(
            name="Session",
            call=lambda **given: Session(PlayConfig(**given)),
            given=lambda: {"policy": ("hand",), "replay": ()},
            bad={
                "policy": [(), ("no such",), ("hand",) * 3, 3],
                "replay": [(folder() / "none",), (3,), 3, (good("agent"),)],
            },
            only=["policy", "replay"],
            also={"replay": ["ReplayLane"]},
        ),
        Target(
            name="Session.choose_scene",
            call=kept.choose_scene,
            given=lambda: {"scene": "free", "difficulty": 0.2, "pushed_object": "small_cube"},
            bad={
                "scene": UNKNOWN,
                "difficulty": [-0.1, 1.5, *NOT_FINITE],
                "pushed_object": UNKNOWN,
            },
        ),
        Target(
            name="Session.choose_policies",
            call=lambda policies: kept.choose_policies(*policies),
            given=lambda: {"policies": ("hand",)},
            bad={"policies": [(), ("no such",), ("hand",) * 3, (3,)]},
            only=["policies"],
            also={"policies": ["policy", "no such"]},
        ),
        Target(
            name="Session.move_goal",
            call=kept.move_goal,
            given=lambda: {"x": 0.5, "y": 0.0},
            bad={"x": [9.0, *NOT_FINITE], "y": [9.0, *NOT_FINITE]},
            also={"x": ["goal", "goal_position"], "y": ["goal", "goal_position"]},
        ),
        Target(
            name="Session.move_obstacle",
            call=kept.move_obstacle,
            given=lambda: {"index": 0, "x": 0.5, "y": 0.0, "yaw": 0.0},
            bad={"index": [-1, 99], "x": NOT_FINITE, "y": NOT_FINITE, "yaw": NOT_FINITE},
            also=dict.fromkeys(("index", "x", "y", "yaw"), ("obstacle", "pose")),
        ),
        Target(
            name="Session.remove_obstacle",
            call=kept.remove_obstacle,
            given=lambda: {"index": 0},
            bad={"index": [-1, 99]},
            also={"index": ["obstacle"]},
        ),
        Target(
            name="Session.add_obstacle",
            call=kept.add_obstacle,
            given=lambda: {"kind": "cube"},
            bad={"kind": UNKNOWN},
        ),
        Target(
            name="Session.reset",
            call=kept.reset,
            given=lambda: {"seed": 0},
            bad={"seed": [-1, -5]},
        ),
    ]


def _commands() -> list[Target]:
    import contextlib
    import io

    import tyro

    def parse(kind: Any, **given: Any) -> Any:
        arguments = [part for name, value in given.items() for part in (f"--{name}", str(value))]
        out = io.StringIO()
        try:
            with contextlib.redirect_stderr(out), contextlib.redirect_stdout(out):
                return tyro.cli(kind, args=[part for part in arguments if part != ""])
        except SystemExit:
            text = " ".join(out.getvalue().replace("│", " ").split())
            raise ValueError(text) from None

    wrong = ["", "abc", "-1", "nan", "1e400", "[]"]
    given: dict[Any, dict[str, Any]] = {
        RunConfig: {"train.seed": 0, "train.tqc.tau": 0.1, "train.env.num-envs": 4},
        EvaluateConfig: {"num-envs": 4, "workers": 1, "episodes": 2},
        DemoConfig: {"episodes": 1, "difficulty": 0.5, "seed": 0},
        PlayConfig: {"difficulty": 0.5, "port": 8080},
        ExportConfig: {"format": "onnx"},
    }
    return [
        Target(
            name=f"command line of {kind.__name__}",
            call=functools.partial(parse, kind),
            given=lambda right=right: dict(right),
            bad=dict.fromkeys(right, wrong),
            only=list(right),
            also={name: [name.rpartition(".")[2].replace("-", "_")] for name in right},
        )
        for kind, right in given.items()
    ]
