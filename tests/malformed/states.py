"""States, scenarios, objects and cameras of environments, with right arguments."""

import json
import math
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from modpush.envs import (
    OBJECTS,
    AnalyticDepthCamera,
    PushState,
    ScenarioConfig,
    sample_scenario,
)
from tests.malformed.environments import env
from tests.malformed.target import NOT_FINITE, UNKNOWN, Target
from tests.test_validation import OBSTACLE


def targets() -> list[Target]:
    """All of them."""
    return [*_state(), *_scenes()]


def _state() -> list[Target]:
    state = env().get_state()
    plain = json.loads(json.dumps(state.to_dict()))
    wrong = [[2], [-1], [0, 0], [0, 1, 2], ["0"], 3, "01", [1.5]]
    broken = [
        replace(state, config={**state.config, "tool": "rod"}),
        replace(state, config={**state.config, "dynamic_obstacles": True}),
        replace(state, step_count=(-1, 0)),
        replace(state, step_count=(0,)),
        replace(state, rngs=({}, {})),
        replace(state, objects={}),
        *(_scene(state, value) for value in (math.nan, math.inf, 1e30)),
        replace(state, scenes=state.scenes[:1]),
        replace(state, scenes=(replace(state.scenes[0], physics=state.scenes[0].physics[:9]),) * 2),
        None,
        {},
        "state",
    ]
    names = ["physics", "step_count", "random", "object", "tool", "dynamic_obstacles", "scenes"]

    def read(**data: Any) -> Any:
        return env().set_state(PushState.from_dict(data))

    return [
        Target(
            name="PushEnv.get_state",
            call=env().get_state,
            given=lambda: {"indices": [0]},
            bad={"indices": wrong},
            only=["indices"],
        ),
        Target(
            name="PushEnv.set_state",
            call=env().set_state,
            given=lambda: {"state": state, "indices": None},
            bad={"state": broken, "indices": wrong},
            only=["state", "indices"],
            also={"state": names, "indices": ["scenes"]},
        ),
        Target(
            name="PushState.from_dict",
            call=read,
            given=lambda: json.loads(json.dumps(plain)),
            bad={
                "scenes": [[], [3, 3], plain["scenes"][:1], None],
                "step_count": [[], [0], [0, "1"], None],
            },
            also={
                "scenes": ["SceneState"],
                "rngs": ["random"],
                "objects": ["object"],
                "config": ["environment"],
            },
        ),
    ]


def _scene(state: PushState, value: float) -> PushState:
    physics = state.scenes[0].physics.copy()
    physics[5] = value
    return replace(state, scenes=(replace(state.scenes[0], physics=physics), state.scenes[1]))


def _scenes() -> list[Target]:
    rng = np.random.default_rng(0)
    camera = AnalyticDepthCamera(env()._batch)
    camera.reset(0)
    image = np.zeros((256, 256), np.float32), np.zeros((256, 256), np.uint8)
    return [
        Target(
            name="sample_scenario",
            call=sample_scenario,
            given=lambda: {"rng": rng, "config": ScenarioConfig(), "tool": "2f85"},
            bad={"rng": [None, 3], "config": [None, {}, "slot"], "tool": UNKNOWN},
            only=["rng", "config"],
        ),
        Target(
            name="PushedObject",
            call=lambda **fields: type(OBJECTS["small_cube"])(**fields),
            given=lambda: {"name": "mine", "parts": OBJECTS["small_cube"].parts, "mass": 1.0},
            bad={
                "parts": [(), (3,), (replace(OBJECTS["small_cube"].parts[0], rpy=(1.0, 0, 0)),)],
                "mass": [0.0, -1.0, 1e9, *NOT_FINITE],
                "name": [""],
            },
        ),
        Target(
            name="Obstacle",
            call=lambda size, pose: type(OBSTACLE)(size, pose),
            given=lambda: {k: tuple(v) for k, v in asdict(OBSTACLE).items()},
            bad={"size": [(0, 1, 1), (-1.0, 1, 1), (1, 1)], "pose": [(0, 0), (math.nan, 0, 0)]},
        ),
        Target(
            name="PushEnv.scenario",
            call=lambda scenario: setattr(env(), "scenario", scenario),
            given=lambda: {"scenario": ScenarioConfig(scene="slot")},
            bad={"scenario": [None, "slot", {}]},
            only=["scenario"],
        ),
        Target(
            name="AnalyticDepthCamera.cast",
            call=camera.cast,
            given=lambda: {"index": 0, "pixels": np.zeros((4, 2))},
            bad={"index": [-1, 2, 99], "pixels": [np.zeros((4, 3)), np.full((4, 2), math.nan)]},
            only=["pixels"],
        ),
        Target(
            name="AnalyticDepthCamera.capture",
            call=camera.capture,
            given=lambda: {"index": 0, "depth": image[0], "segmentation": image[1]},
            bad={
                "index": [-1, 2, 99],
                "depth": [image[0][:9], image[0].astype(float), None],
                "segmentation": [image[1][:9], image[0], None],
            },
            only=["depth", "segmentation"],
        ),
    ]
