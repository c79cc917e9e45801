"""Evaluation sets, runs over them and their tables, with right arguments."""

import functools
import tempfile
from dataclasses import asdict
from typing import Any

import pandas as pd
import torch

from modpush import evaluation
from modpush.envs import EpisodeConditions
from modpush.evaluation.results import COLUMNS
from tests.malformed.files import folder, good
from tests.malformed.target import BELOW_1, NOT_FINITE, UNKNOWN, Target


def targets() -> list[Target]:
    """All of them."""
    return [*_sets(), *_tables(), *_reports(), *_evaluation()]


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
            given=lambda: {"table": rows()},
            bad={"table": [None, 3, {}]},
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


def _reports() -> list[Target]:
    smoke = evaluation.load_set("smoke")
    frames = [None, 3, rows().iloc[:0], rows().drop(columns="success"), "text"]
    return [
        Target(
            name="comparison_report",
            call=evaluation.comparison_report,
            given=lambda: {"rows": {"a": rows()}},
            bad={"rows": [{}, 3, None, *({"a": frame} for frame in frames)]},
            only=["rows"],
            also={"rows": ["success"]},
        ),
        Target(
            name="draw_results",
            call=evaluation.draw_results,
            given=lambda: {
                "rows": rows(),
                "episodes": smoke,
                "folder": folder(),
                "policy": "made",
                "pictures": 0,
                "videos": False,
            },
            bad={
                "rows": frames,
                "episodes": [None, 3, "smoke", smoke.scenarios],
                "folder": [3, None],
                "policy": [3, None],
                "pictures": [-1, 1.5, "3"],
            },
            only=["rows", "episodes", "folder", "policy", "pictures"],
            also={"rows": ["success"]},
        ),
        Target(
            name="to_display",
            call=evaluation.to_display,
            given=lambda: {"summary": evaluation.summarize({"a": rows()})},
            bad={"summary": [None, 3, {}, "text", rows()]},
            only=["summary"],
        ),
        Target(
            name="EpisodeConditions.from_dict",
            call=lambda **data: EpisodeConditions.from_dict(data),
            given=lambda: asdict(EpisodeConditions()),
            also=dict.fromkeys(asdict(EpisodeConditions()), ("plain data",)),
            bad={"tool": UNKNOWN, "inflation": UNKNOWN, "max_episode_steps": BELOW_1},
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
