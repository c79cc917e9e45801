"""Environments: making, resetting and stepping them, with right arguments."""

import functools
import math
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict

from modpush.envs import (
    PushEnv,
    PushGymEnv,
)
from modpush.recipes import PaperGymEnv, make_push_env
from tests.malformed.target import BELOW_1, NOT_FINITE, UNKNOWN, Target
from tests.test_validation import SCENARIO

OPTIONS = {
    "num_envs": 1,
    "scene": "slot",
    "pushed_object": "small_cube",
    "difficulty": 0.5,
    "distance": (0.2, 0.3),
    "depth": None,
    "arm_in_depth": False,
    "tool": "2f85",
    "dynamic_obstacles": False,
    "sim_freq": 120,
    "control_freq": 15,
    "max_episode_steps": 200,
    "oob": "truncate",
    "seed": 0,
    "device": "cpu",
}

WRONG = {
    "num_envs": [*BELOW_1, 10**9],
    "scene": [*UNKNOWN, (), ("slot", "no such"), 3],
    "pushed_object": [*UNKNOWN, (), 3, ("small_cube", "small_cube")],
    "difficulty": [-0.1, 1.5, *NOT_FINITE, (0.9, 0.1)],
    "distance": [0.0, (0.6, 0.2), *NOT_FINITE, 50.0],
    "depth": [*UNKNOWN, 3, object()],
    "tool": [*UNKNOWN, None],
    "sim_freq": [*BELOW_1, 100, 7],
    "control_freq": [*BELOW_1, 7, 1000],
    "max_episode_steps": BELOW_1,
    "oob": UNKNOWN,
    "seed": [-1, "0", 1.5],
    "device": ["", "no such", "cuda:99", 3],
}

_OPTIONAL = ("seed", "max_episode_steps", "depth")


def targets() -> list[Target]:
    """All of them."""
    return [*_construction(), *_reset(), *_step()]


@functools.cache
def env() -> PushEnv:
    """Two scenes that are kept, without images."""
    made = PushEnv(2, scene="slot", depth=None, seed=0)
    made.reset()
    return made


@functools.cache
def stack() -> Any:
    """The paper's stack on two scenes."""
    made = make_push_env(num_envs=2, scene="slot", encoder="rays", seed=0)
    made.reset()
    return made


@functools.cache
def gym_env() -> PushGymEnv:
    """One scene."""
    made = PushGymEnv(depth=None, seed=0)
    made.reset()
    return made


def _construction() -> list[Target]:
    given = {**OPTIONS, "encoder": "rays", "planner": "a_star", "max_waypoints": 0}
    gym = {key: value for key, value in OPTIONS.items() if key != "num_envs"}
    return [
        Target(
            name="PushEnv",
            call=PushEnv,
            given=lambda: dict(OPTIONS),
            bad=WRONG,
            may_be_none=_OPTIONAL,
        ),
        Target(
            name="make_push_env",
            call=make_push_env,
            given=lambda: {**given, "keep_images": False},
            bad={
                **WRONG,
                "encoder": [*UNKNOWN, 3, object()],
                "planner": [*UNKNOWN, 3, object()],
                "max_waypoints": [-1, 1],
            },
            may_be_none=_OPTIONAL,
        ),
        Target(
            name="PushGymEnv",
            call=PushGymEnv,
            given=lambda: {"render_mode": None, **gym},
            bad={**WRONG, "render_mode": [*UNKNOWN, "human"]},
            may_be_none=_OPTIONAL,
        ),
        Target(
            name="PaperGymEnv",
            call=PaperGymEnv,
            given=lambda: {"preset": "cpu", "render_mode": None, **gym, "depth": "analytic"},
            bad={**WRONG, "render_mode": [*UNKNOWN, "human"], "preset": UNKNOWN},
            may_be_none=_OPTIONAL,
        ),
    ]


def _reset() -> list[Target]:
    start = replace(SCENARIO, obstacles=())
    state = env().get_state()
    many = [[], [start], [start] * 3, [start, "slot"], "slot", 3, [None, None]]
    at_goal = replace(start, goal_position=start.object_pose[:2])
    far = replace(start, tool_pose=(90.0, 0.0, 0.0))
    return [
        Target(
            name="PushEnv.reset",
            call=env().reset,
            given=lambda: {"scenarios": [start, start]},
            bad={
                "scenarios": [
                    *many,
                    [start, at_goal],
                    [start, far],
                    [start, replace(start, pushed_object="large_cube")],
                ]
            },
            only=["scenarios"],
            also={"scenarios": ["pushed_object", "tool_pose", "Scenario"]},
        ),
        Target(
            name="PushEnv.reset(seed)",
            call=env().reset,
            given=lambda: {"seed": 0},
            bad={"seed": [-1, -(10**9)]},
            may_be_none=["seed"],
        ),
        Target(
            name="PushEnv.reset(state)",
            call=env().reset,
            given=lambda: {"state": state, "seed": None},
            bad={"state": [3, "state", state.to_dict(), env().get_state([0])], "seed": [3]},
            only=["state", "seed"],
        ),
        Target(
            name="PushEnv.reset(_reset)",
            call=lambda _reset: env().reset(TensorDict({"_reset": _reset}, [2])),
            given=lambda: {"_reset": torch.ones(2, 1, dtype=torch.bool)},
            bad={
                "_reset": [
                    torch.ones(2, 1),
                    torch.ones(2, dtype=torch.int64),
                ]
            },
            only=["_reset"],
        ),
        Target(
            name="PushGymEnv.reset",
            call=gym_env().reset,
            given=lambda: {"seed": 0, "options": {"scenario": start}},
            bad={"seed": [-1], "options": [{"no such": 1}, {"scenario": 3}, 3, "text"]},
            only=["options"],
            also={"options": ["scenarios", "scenario"]},
        ),
    ]


def _step() -> list[Target]:
    zero = torch.zeros(2, 3)
    wrong = [
        zero[:, :2],
        zero[:, :0],
        zero[:1],
        torch.zeros(2, 4),
        torch.zeros(3, 3),
        zero.long(),
        zero.bool(),
        zero + 1.5,
        zero - 1.5,
        zero * math.nan,
        zero + math.inf,
        zero.to(torch.complex64),
        zero.half(),
    ]
    row = [np.zeros(2), np.zeros((1, 3)), np.full(3, math.nan), np.ones(3) * 2, None, "text", 3]

    def step(where: Any, action: Any) -> Any:
        return where.step(TensorDict({"action": action}, [len(action)]))

    def stacked(action: Any) -> Any:
        start = stack().reset()
        start["action"] = action
        return stack().step(start)

    return [
        Target(
            name="PushEnv.step",
            call=lambda action: step(env(), action),
            given=lambda: {"action": zero.clone()},
            bad={"action": wrong},
            only=["action"],
            also={"action": ["batch", "shape"]},
        ),
        Target(
            name="make_push_env.step",
            call=stacked,
            given=lambda: {"action": zero.clone()},
            bad={"action": [one for one in wrong if len(one) == 2]},
            only=["action"],
        ),
        Target(
            name="PushGymEnv.step",
            call=gym_env().step,
            given=lambda: {"action": np.zeros(3)},
            bad={"action": row},
            only=["action"],
        ),
        Target(
            name="PushEnv.cast",
            call=env().cast,
            given=lambda: {"index": 0, "pixels": np.zeros((4, 2))},
            bad={
                "index": [-1, 2, 99],
                "pixels": [np.zeros((4, 3)), np.full((4, 2), math.nan), np.zeros(3), "text", None],
            },
            only=["pixels"],
        ),
        Target(
            name="PushEnv.render",
            call=env().render,
            given=lambda: {"index": 0},
            bad={"index": [-1, 2, 99]},
        ),
    ]
