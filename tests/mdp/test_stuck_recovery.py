"""When a recovery begins, what it does, and that it ends what it is for."""

import math
import pickle

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torchrl.envs import TransformedEnv, check_env_specs

import modpush
from modpush.envs import PushEnv
from modpush.mdp import StuckRecovery, recovering

GOLDEN = math.pi * (3 - math.sqrt(5))


def poses(tool=0.0, thing=0.0, scenes=1) -> TensorDict:
    """The tool's tip and the object, moved along x and y by so much."""
    where = torch.tensor([[tool, 0.0, 0.0]]).expand(scenes, 3)
    return TensorDict(
        {"ee_pose": where.clone(), "object_pose": torch.tensor([[0.3, thing, 0.0]] * scenes)},
        [scenes],
    )


def run(recovery: StuckRecovery, moves: list[tuple[float, float]]) -> list[TensorDict]:
    """States of one episode: at reset, then after each step, with tool and object there."""
    states = [recovery._reset(TensorDict({}, [1]), poses())]
    for tool, thing in moves:
        states.append(recovery._step(states[-1], poses(tool, thing)))
    return states


def active(states: list[TensorDict]) -> list[bool]:
    return [bool(state["recovering"]) for state in states]


def test_what_stands_still_gets_an_action_for_some_steps() -> None:
    states = run(StuckRecovery(patience=3, duration=2), [(0.0, 0.0)] * 3)
    assert active(states) == [False, False, False, True]
    assert not states[2]["recovery_action"].any()
    torch.testing.assert_close(states[3]["recovery_action"], torch.tensor([[-1.0, 0.0, 1.0]]))

    # The tool moves on; after two steps the policy has its way again.
    moving = [(0.0, 0.0)] * 3 + [(-0.02, 0.0), (-0.04, 0.0), (-0.06, 0.0)]
    assert active(run(StuckRecovery(patience=3, duration=2), moving))[3:] == [
        True,
        True,
        False,
        False,
    ]


def test_by_default_it_waits_for_four_steps_and_acts_for_four() -> None:
    moving = [(0.0, 0.0)] * 4 + [(0.02 * n, 0.0) for n in range(1, 6)]
    states = run(StuckRecovery(), moving)
    assert active(states) == [False] * 4 + [True] * 4 + [False] * 2
    # One centimetre along an axis is still at rest, more is not.
    for apart, waits in ((0.0099, True), (0.0101, False)):
        assert active(run(StuckRecovery(), [(apart, 0.0)] * 4))[-1] == waits


def test_each_time_has_a_direction_of_its_own() -> None:
    """Nothing moves whatever is done: one recovery follows the other."""
    states = run(StuckRecovery(patience=3, duration=2), [(0.0, 0.0)] * 9)[3:]
    assert all(active(states))
    for n, state in enumerate(states):
        angle, turn = math.pi + n // 2 * GOLDEN, 1.0 - 2 * (n // 2 % 2)
        expected = torch.tensor([[math.cos(angle), math.sin(angle), turn]])
        torch.testing.assert_close(state["recovery_action"], expected)


def test_after_every_third_recovery_the_next_ones_are_two_steps_longer() -> None:
    states = run(StuckRecovery(patience=3, duration=2), [(0.0, 0.0)] * 40)[3:]
    recoveries = [int(state["recovery_state"][0, 6]) for state in states]
    assert [recoveries.count(n) for n in range(1, 8)] == [2, 2, 2, 4, 4, 4, 6]


@pytest.mark.parametrize("which", [0, 1])
def test_what_moves_is_left_alone(which) -> None:
    """A tool that goes round a still object, and an object that slides on; drift counts, too."""
    for speed in (0.02, 0.004):
        moves = [tuple(speed * n * (k == which) for k in range(2)) for n in range(1, 40)]
        assert not any(active(run(StuckRecovery(patience=3), moves)))  # type: ignore[arg-type]
    moves = [tuple(0.001 * (n % 2) * (k == which) for k in range(2)) for n in range(1, 5)]
    assert active(run(StuckRecovery(patience=3), moves))[-1]  # type: ignore[arg-type]


def test_in_an_environment_scenes_are_kept_apart() -> None:
    recovery = pickle.loads(pickle.dumps(StuckRecovery(patience=2, duration=3)))
    env = TransformedEnv(PushEnv(2, depth=None, seed=0), recovery)
    check_env_specs(env)
    td = env.reset()
    for _ in range(2):
        _, td = env.step_and_maybe_reset(td.set("action", torch.zeros(2, 3)))
    assert td["recovering"].all()
    td["_reset"] = torch.tensor([[True], [False]])
    td = env.reset(td)
    assert td["recovering"].tolist() == [[False], [True]]

    # The policy that stands still is moved; in the first scene it is not yet.
    policy = recovering(TensorDictModule(torch.zeros_like, ["ee_pose"], ["action"]))
    before = td["ee_pose"].clone()
    action = policy(td)["action"]
    torch.testing.assert_close(action, torch.tensor([[0.0, 0.0, 0.0], [-1.0, 0.0, 1.0]]))
    moved = (env.step(td)["next", "ee_pose"] - before).norm(dim=-1)
    assert moved[0] < 0.002 < 0.01 < moved[1]
    env.close()


def test_the_shipped_agent_runs_with_it() -> None:
    agent = modpush.load_agent("any_object")
    env = agent.make_env(2, seed=0, scene="free").append_transform(StuckRecovery())
    rollout = env.rollout(60, recovering(agent.policy), break_when_any_done=False)
    assert rollout["next", "success"].any(1).all()
    env.close()
