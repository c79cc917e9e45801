import json
from dataclasses import replace

import pytest
import torch
from torchrl.envs import Compose, RewardSum, StepCounter, TransformedEnv

from modpush.envs import OBJECTS, PushEnv, PushState


def act(env, td, *action: float):
    return env.step(td.set("action", torch.tensor([action] * env.batch_size[0])))["next"]


@pytest.fixture(scope="module")
def pushed() -> tuple[PushEnv, PushState]:
    """Two scenes in the midst of pushing, and their state."""
    env = PushEnv(2, scene="slot", depth=None, seed=0)
    td = env.reset()
    for _ in range(6):
        td = act(env, td, 1.0, 0.2, 0.1)
    return env, env.get_state()


def test_a_state_comes_back_from_json_to_the_last_bit(pushed) -> None:
    env, state = pushed
    again = PushState.from_dict(json.loads(json.dumps(state.to_dict())))
    ends = []
    for one in (state, again):
        td = env.set_state(one)
        for _ in range(10):
            td = act(env, td, 0.7, -0.5, 0.0)
        ends.append(td)
    for key in env.observation_spec.keys():
        assert torch.equal(ends[0][key], ends[1][key]), key
    assert again.to_dict() == state.to_dict()
    assert env.reset() is not None
    assert again.step_count == (6, 6)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"tool": "rod"}, r"of an environment with tool='2f85' \(expected 'rod'\)"),
        ({"dynamic_obstacles": True}, r"dynamic_obstacles=False \(expected True\)"),
        ({"sim_freq": 240}, r"sim_freq=120 \(expected 240\)"),
        ({"control_freq": 20}, r"control_freq=15 \(expected 20\)"),
        ({"pushed_object": "fragment"}, r"object 'small_cube' is not in this environment"),
        (
            {"pushed_object": replace(OBJECTS["small_cube"], mass=2.0)},
            "'small_cube' must be this environment's of that name",
        ),
    ],
)
def test_a_state_of_another_environment_is_refused_before_anything_moves(
    pushed, options, message
) -> None:
    _, state = pushed
    env = PushEnv(2, **{"scene": "slot", "depth": None, "seed": 3, **options})
    td = env.reset()
    before = env.get_state().to_dict()
    with pytest.raises(ValueError, match=message):
        env.set_state(state)
    assert env.get_state().to_dict() == before
    assert torch.equal(env._observe()["object_pose"], td["object_pose"])
    env.close()


def damaged(data: dict, path: tuple, value: object) -> dict:
    data = json.loads(json.dumps(data))
    *way, last = path
    inner = data
    for key in way:
        inner = inner[key]
    inner[last] = value(inner[last]) if callable(value) else value
    return data


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (("scenes", 1, "physics"), lambda x: x[:-3], r"physics must be float32 of shape \(50,\)"),
        (("scenes", 1, "physics"), [], r"physics must be float32 of shape \(50,\)"),
        (("scenes", 1, "physics", 5), float("nan"), "finite and at most 10000, got nan"),
        (("scenes", 1, "physics", 5), 1e30, "finite and at most 10000, got 1"),
        (("scenes", 1, "physics", 0), 7.0, "quaternions in physics must be of length 1"),
        (("scenes", 1, "physics"), "abc", "SceneState: physics must be numbers"),
        (("scenes", 1, "target"), [0.4, 0.0], r"scenes\[1\].target\[2\]: Field required"),
        (("scenes", 1, "target", 0), float("inf"), r"target\[0\]: Input should be a finite number"),
        (("scenes", 1, "contacts"), [1, 2], r"contacts\[0\]: Input should be a valid boolean"),
        (
            ("scenes", 1, "target_reachable"),
            "yes",
            "target_reachable: Input should be a valid boolean",
        ),
        (("scenes", 1, "scenario", "tool_pose"), [3.0, 0.0, 0.0], "out of the arm's reach"),
        (("scenes", 1), {}, r"scenes\[1\].scenario: Field required"),
        (("scenes",), lambda x: x[:1], "the state holds 1 scenes, expected 2"),
        (("scenes",), 3, "scenes: Input should be a valid array, got 3"),
        (("step_count", 0), -1, r"step_count\[0\]: Input should be greater than or equal to 0"),
        (("rngs", 1), {"bit_generator": "PCG64"}, "random number generator is damaged"),
        (("rngs",), [], "holds 0 rngs, expected 2"),
        (("config",), {}, "tool=None"),
        (("objects",), {}, "'small_cube' must be this environment's"),
    ],
)
def test_a_damaged_state_is_refused_before_anything_moves(pushed, path, value, message) -> None:
    env, state = pushed
    before = env.get_state().to_dict()
    with pytest.raises(ValueError, match=message):
        env.set_state(PushState.from_dict(damaged(state.to_dict(), path, value)))
    assert env.get_state().to_dict() == before


def test_reset_takes_a_state_through_transforms(pushed) -> None:
    base, state = pushed
    env = TransformedEnv(base, Compose(StepCounter(), RewardSum()))
    td = env.reset(state=state)
    assert torch.equal(td["object_pose"], base.set_state(state)["object_pose"])
    assert td["step_count"].tolist() == [[0], [0]]
    assert td["episode_reward"].tolist() == [[0.0], [0.0]]
    with pytest.raises(ValueError, match="with state, scenarios and seed must be None"):
        env.reset(state=state, seed=1, scenarios=base.scenarios)


def test_reset_of_some_scenes_takes_a_state_of_these(pushed) -> None:
    env, state = pushed
    other = env.reset()
    one = PushState(
        scenes=state.scenes[1:],
        step_count=state.step_count[1:],
        steps_at_goal=state.steps_at_goal[1:],
        rngs=state.rngs[1:],
        config=state.config,
        objects=state.objects,
    )
    td = env.reset(other.set("_reset", torch.tensor([[False], [True]])), state=one)
    assert torch.equal(td["object_pose"][0], other["object_pose"][0])
    assert torch.equal(td["object_pose"][1], env.set_state(state)["object_pose"][1])
