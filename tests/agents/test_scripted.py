import math

import pytest
import torch
from tensordict import TensorDict

from modpush.agents import ScriptedPusher
from modpush.agents.corridor.config import CorridorConfig
from modpush.agents.scripted import _MARGIN, _MAX_TURN, _STEER_GAIN, _TOOL_RADIUS, scripted_push
from modpush.envs import PushEnv
from modpush.envs.robot.control import MotionConfig


def push(obj, target, ee, contact=False):
    rows = (torch.tensor([v], dtype=torch.float32) for v in (obj, target, ee))
    return scripted_push(*rows, torch.tensor([[contact]]), torch.tensor([[0.035]]))[0]


def test_right_behind_it_goes_straight_on() -> None:
    # Tool at x = 0.4, object at 0.5, target at 0.7; the wide side already across.
    action = push([0.5, 0.0], [0.7, 0.0], [0.4, 0.0, math.pi / 2])
    assert action.tolist() == pytest.approx([1.0, 0.0, 0.0], abs=1e-5)


def test_an_action_is_scaled_to_the_largest_turn_of_the_environment() -> None:
    assert _MAX_TURN == CorridorConfig().max_turn == MotionConfig().max_turn


def test_in_front_of_it_it_goes_round_and_not_through() -> None:
    circle = 0.035 + _TOOL_RADIUS + _MARGIN
    action = push([0.5, 0.0], [0.7, 0.0], [0.5 + circle, 0.001, 0.0])
    assert abs(action[0].item()) < 0.05
    assert abs(action[1].item()) > 0.99


def test_it_steers_back_onto_the_line() -> None:
    # In contact, left of the line (y > 0): it steers farther left, so that the object turns right.
    action = push([0.5, 0.0], [0.7, 0.0], [0.45, 0.01, math.pi / 2], contact=True)
    bearing = math.atan2(-0.01, 0.05)
    assert math.atan2(action[1], action[0]) == pytest.approx((1 + _STEER_GAIN) * bearing)


@pytest.mark.parametrize("turn", [0.3, 1.7, -2.5])
def test_turning_the_whole_scene_turns_the_action(turn) -> None:
    c, s = math.cos(turn), math.sin(turn)

    def turned(p):
        return [c * p[0] - s * p[1], s * p[0] + c * p[1], *[a + turn for a in p[2:]]]

    scene = ([0.5, 0.02], [0.7, 0.1], [0.42, -0.05, 0.4])
    plain, other = push(*scene), push(*(turned(p) for p in scene))
    assert turned(plain[:2].tolist()) == pytest.approx(other[:2].tolist(), abs=1e-5)
    assert plain[2].item() == pytest.approx(other[2].item(), abs=1e-4)


def test_keys_can_be_renamed_and_nested() -> None:
    policy = ScriptedPusher(
        target_key=("plan", "subgoal"), object_pose_key=("state", "object"), action_key=("out", "a")
    )
    td = TensorDict(
        {
            "plan": {"subgoal": torch.rand(4, 2)},
            "state": {"object": torch.rand(4, 3)},
            "ee_pose": torch.rand(4, 3),
            "object_contact": torch.zeros(4, 1, dtype=torch.bool),
            "object_radius": torch.full((4, 1), 0.035),
        },
        [4],
    )
    assert policy(td)["out", "a"].shape == (4, 3)
    with pytest.raises(KeyError, match=r"key .*goal_position.* is missing; there are"):
        ScriptedPusher(object_pose_key=("state", "object"))(td)


@pytest.mark.parametrize("episodes", [50, pytest.param(200, marks=pytest.mark.slow)])
def test_nine_of_ten_in_free_space(episodes) -> None:
    env, policy, results = PushEnv(8, depth=None, seed=1), ScriptedPusher(), []
    td = env.reset()
    while len(results) < episodes:
        td = env.step(policy(td))["next"]
        if td["done"].any():
            results += td["success"][td["done"]].tolist()
            td = env.reset(td.clone().set("_reset", td["done"].clone()))
    env.close()
    assert sum(results) / len(results) >= 0.90
