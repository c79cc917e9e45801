"""Goals with orientation: tolerances, symmetry, holding, states, and what is refused."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from modpush.envs import PushedObject, PushEnv, Scenario, ScenarioConfig, sample_scenario
from modpush.envs.outcome import pose_errors
from modpush.envs.push_state import PushState
from modpush.envs.scenes.drawing import COLORS
from modpush.envs.scenes.objects import OBJECTS
from modpush.geometry.shapes import box

TIGHT = {"goal": "pose", "position_tolerance": 0.015, "yaw_tolerance": math.radians(10)}


def start(goal=(0.5, 0.0, 0.0), object_pose=(0.5, 0.0, 1.0)) -> Scenario:
    """The box away from the tool."""
    return Scenario(
        scene="free",
        difficulty=0.0,
        obstacles=(),
        pushed_object="box",
        object_pose=object_pose,
        goal_position=goal[:2],
        tool_pose=(0.3, -0.2, 0.0),
        goal_yaw=goal[2],
    )


@pytest.fixture(scope="module")
def env():
    env = PushEnv(2, pushed_object="box", depth=None, **TIGHT)
    yield env
    env.close()


def outcome(
    env: PushEnv, *scenarios: Scenario, steps: int = 1, yaw_tolerance=TIGHT["yaw_tolerance"]
):
    """What follows some steps in which the tool stands still."""
    env.yaw_tolerance = math.radians(10)
    td = env.reset(scenarios=list(scenarios))
    env.yaw_tolerance = yaw_tolerance  # which else refuses the start
    for _ in range(steps):
        td = env.step(td.set("action", torch.zeros(*env.batch_size, 3)))["next"]
    return td


@pytest.mark.parametrize(
    ("turn", "symmetry", "expected"),
    [
        (0.2, 1, 0.2),
        (math.pi + 0.2, 1, 0.2 - math.pi),
        (math.pi + 0.2, 2, 0.2),
        (math.pi / 2 - 0.2, 4, -0.2),
        (1.0, 3, 1.0),
        (1.1, 3, 1.1 - 2 * math.pi / 3),
        (2.0, 0, 0.0),  # a disc
    ],
)
def test_yaw_is_compared_modulo_the_symmetry(turn, symmetry, expected) -> None:
    goal = np.array([[0.3, 0.4, 0.5 + turn]])
    error = pose_errors(np.array([[0.0, 0.0, 0.5]]), goal, np.array([symmetry]))
    assert error[0] == pytest.approx([0.5, expected])


def test_success_needs_position_and_yaw(env) -> None:
    near = math.radians(9.9)
    apart = start((0.5, 0.0, 0.0), (0.514, 0.0, math.radians(12)))  # turned too far
    far = start((0.5, 0.0, 0.0), (0.516, 0.0, near))
    td = outcome(env, apart, far)
    assert td["success"].flatten().tolist() == [False, False]
    assert td["pose_error"][0].tolist() == pytest.approx([0.014, -math.radians(12)], abs=1e-3)
    td = outcome(env, apart, far, yaw_tolerance=math.radians(12.5))
    assert td["success"].flatten().tolist() == [True, False]


def test_a_box_may_lie_the_other_way_round_unless_the_full_circle_counts(env) -> None:
    turned = start((0.5, 0.0, math.pi), (0.5, 0.0, 0.3))
    assert outcome(env, turned, turned)["pose_error"][0, 1] == pytest.approx(-0.3, abs=1e-3)
    full = PushEnv(1, pushed_object="box", depth=None, full_circle=True, **TIGHT)
    td = outcome(full, turned)
    assert td["pose_error"][0, 1] == pytest.approx(math.pi - 0.3, abs=1e-3)
    assert td["object_symmetry"].item() == 1.0
    full.close()


def test_the_goal_must_be_held() -> None:
    env = PushEnv(1, pushed_object="box", depth=None, hold_steps=3, **TIGHT)
    td = outcome(env, start((0.5, 0.0, 0.0), (0.5, 0.0, 0.3)), steps=2, yaw_tolerance=0.31)
    assert not td["success"].item()
    state = PushState.from_dict(json.loads(json.dumps(env.get_state().to_dict())))
    assert state.steps_at_goal == (2,)
    for _ in range(2):  # once from the state, and once more
        td = env.set_state(state)
        assert not td["success"].item()
        td = env.step(td.set("action", torch.zeros(1, 3)))["next"]
        assert td["success"].item()
        assert td["terminated"].item()
    older = {k: v for k, v in state.to_dict().items() if k != "steps_at_goal"}
    assert PushState.from_dict(older).steps_at_goal == (0,)
    env.close()


def test_only_the_position_may_be_tighter() -> None:
    env = PushEnv(1, depth=None, position_tolerance=0.01)
    assert "pose_error" not in env.reset().keys()
    near = replace(start(), pushed_object="small_cube", goal_yaw=None, goal_position=(0.511, 0.0))
    assert not outcome(env, near)["success"].item()
    env.close()


def test_drawn_starts_are_those_of_goal_positions() -> None:
    config = ScenarioConfig(scene=("free", "posts"), pushed_object="box")
    for seed in range(20):
        posed, plain = (
            sample_scenario(np.random.default_rng(seed), config, goal=goal)
            for goal in ("pose", "position")
        )
        assert replace(posed, goal_yaw=None) == plain
        assert Scenario.from_dict(json.loads(json.dumps(posed.to_dict()))) == posed
        assert "goal_yaw" not in plain.to_dict()


def test_drawn_yaws_are_uniform() -> None:
    rng, config = np.random.default_rng(0), ScenarioConfig(pushed_object="box")
    yaw = np.array([sample_scenario(rng, config, goal="pose").goal_yaw for _ in range(400)])
    assert -math.pi <= yaw.min() < -3.0 < 3.0 < yaw.max() <= math.pi
    assert abs(np.exp(1j * yaw).mean()) < 0.15


def test_the_goal_is_drawn_with_its_orientation(env) -> None:
    env.reset(scenarios=[start((0.6, 0.1, 0.0)), start((0.6, 0.1, 1.57))])
    green = [(env.render(i) == np.array(COLORS["goal"])).all(-1) for i in range(2)]
    tall, wide = (np.ptp(np.argwhere(mask), axis=0) for mask in green)
    assert tall[0] > wide[0] + 10  # along x, which is up
    assert wide[1] > tall[1] + 10


def test_scenarios_of_the_other_kind_are_refused(env) -> None:
    with pytest.raises(ValueError, match=r"scenarios\[1\] must have a goal_yaw with goal='pose'"):
        env.reset(scenarios=[start(), replace(start(), goal_yaw=None)])
    with pytest.raises(
        ValueError, match=r"must start more than 0.015 m from its goal or be turned"
    ):
        env.reset(scenarios=[start(), start((0.5, 0.01, 1.1))])
    plain = PushEnv(1, pushed_object="box", depth=None)
    with pytest.raises(ValueError, match=r"must have no goal_yaw with goal='position', got 0.0"):
        plain.reset(scenarios=[start()])
    env.reset()
    plain.reset()
    with pytest.raises(
        ValueError, match=r"state's goal_yaw is .*an environment with goal='position'"
    ):
        plain.set_state(env.get_state([0]))
    plain.close()
    with pytest.raises(ValueError, match=r"goal must be one of .*, got 'place'"):
        sample_scenario(np.random.default_rng(0), ScenarioConfig(), goal="place")
    with pytest.raises(ValueError, match="goal_yaw"):
        replace(start(), goal_yaw=math.nan)


def test_the_box_is_oblong_and_an_object_of_your_own_may_have_no_symmetry() -> None:
    assert OBJECTS["box"].symmetry == 2
    assert OBJECTS["box"].radius == pytest.approx(math.hypot(0.05, 0.025))
    marked = PushedObject(name="marked", parts=(box(0.10, 0.05, 0.05),), symmetry=1)
    env = PushEnv(1, pushed_object=marked, depth=None, goal="pose")
    turned = replace(start((0.5, 0.0, math.pi), (0.5, 0.0, 0.0)), pushed_object="marked")
    assert abs(outcome(env, turned)["pose_error"][0, 1]) == pytest.approx(math.pi, abs=1e-3)
    env.close()
