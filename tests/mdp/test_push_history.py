"""An agent's memory of the last steps in which the object was touched or moved."""

import math

import pytest
import torch
from torchrl.envs import Compose, SerialEnv, TransformedEnv, check_env_specs

from modpush.envs import PushEnv
from modpush.mdp import ActionFrame, MirroredObservation, PushHistory, PushObservation
from modpush.recipes import PushEnvConfig, make_push_env
from tests.envs.engines.sapien.test_agent import scenario
from tests.mdp.test_push_observation import make_state

# The tool 7 cm behind the cube, which lies turned by a quarter turn; the goal is ahead along x.
BEHIND = scenario((0.29, 0.0, 0.0), (0.36, 0.0, math.pi / 2))
FORWARD = torch.tensor([[0.5, 0.0, 0.0]])


def make(scenes=1, frame="base"):
    base = PushEnv(scenes, scene="free", depth=None, seed=0)
    return TransformedEnv(base, Compose(ActionFrame(frame), PushHistory(frame)))


def push(env, td, steps, action=FORWARD):
    for _ in range(steps):
        td = env.step_mdp(env.step(td.set("action", action.expand(*env.batch_size, 3).clone())))
    return td


def test_specs_hold_alone_and_in_serial_environments():
    env = make(2)
    check_env_specs(env)
    env.close()
    env = SerialEnv(2, make)
    check_env_specs(env)
    env.close()


def test_a_push_is_remembered_in_the_object_s_frame_newest_first():
    env = make()
    td = env.reset(scenarios=[BEHIND])
    assert td["history"].shape == (1, 8, 10)
    assert not td["history"].any()
    td = push(env, td, 1)
    before = push(env, td, 3)
    after = env.step(before.set("action", FORWARD.clone()))["next"]
    env.close()
    newest = after["history"][0, 0]
    # The object's x is the base's y, and the object's y the base's -x.
    tip = before["ee_pose"][0, :2] - before["object_pose"][0, :2]
    expected = torch.stack([tip[1], -tip[0]])
    torch.testing.assert_close(newest[:2], expected, atol=1e-3, rtol=0)
    torch.testing.assert_close(newest[2:4], torch.tensor([0.0, -0.5]), atol=1e-3, rtol=0)
    moved = (after["object_pose"] - before["object_pose"])[0]
    assert moved[0] > 0.005  # it was pushed
    torch.testing.assert_close(newest[7], -moved[0], atol=1e-4, rtol=0)
    assert newest[8] == pytest.approx(moved[2].item(), abs=1e-6)
    assert newest[9] == 1
    assert torch.equal(after["history"][0, 1:], before["history"][0, :-1])


def test_steps_without_contact_and_motion_are_left_out():
    env = make()
    td = push(env, env.reset(scenarios=[BEHIND]), 5)
    held = td["history"].clone()
    assert held.any()
    td = push(env, td, 6, torch.tensor([[-1.0, 0.0, 0.0]]))  # away from the object
    counted = int((td["history"] != 0).any(-1).sum())
    assert torch.equal(
        td["history"][0, counted - int((held != 0).any(-1).sum()) :][:2], held[0, :2]
    )
    rest = td["history"].clone()
    td = push(env, td, 3, torch.tensor([[-1.0, 0.0, 0.0]]))
    env.close()
    assert torch.equal(td["history"], rest)


def test_a_scene_that_is_reset_alone_forgets_and_the_others_do_not():
    env = make(2)
    td = push(env, env.reset(scenarios=[BEHIND, BEHIND]), 5)
    held = td["history"].clone()
    assert held[0].any()
    assert held[1].any()
    td = env.reset(td.set("_reset", torch.tensor([[True], [False]])))
    assert not td["history"][0].any()
    assert torch.equal(td["history"][1], held[1])
    td = push(env, td, 1)
    env.close()
    assert torch.equal(td["history"][1, 1:], held[1, :-1])


def test_a_scene_does_not_depend_on_those_beside_it():
    env = make(1)
    alone = push(env, env.reset(scenarios=[BEHIND]), 6)["history"]
    env.close()
    env = make(3)
    other = scenario((0.42, 0.2, 0.0), (0.5, 0.2, 0.3))
    beside = push(env, env.reset(scenarios=[other, BEHIND, other]), 6)["history"]
    env.close()
    assert torch.equal(alone[0], beside[1])
    assert not torch.equal(beside[0], beside[1])


def test_the_agent_s_action_is_turned_to_the_object():
    found = []
    for frame, action in (("base", [0.5, 0.0, 0.0]), ("object", [0.0, -0.5, 0.0])):
        env = make(1, frame)
        td = push(env, env.reset(scenarios=[BEHIND]), 5, torch.tensor([action]))
        found.append(td["history"])
        env.close()
    torch.testing.assert_close(*found, atol=1e-3, rtol=0)


def mirrored(td):
    """The same at the base frame's other side."""
    td = td.clone()
    for key in ("object_pose", "ee_pose", "action"):
        td[key] = td[key] * torch.tensor([1.0, -1.0, -1.0])
    td["subgoal"] = td["subgoal"] * torch.tensor([1.0, -1.0])
    return td


@pytest.mark.parametrize("frame", ["base", "object", "path"])
def test_the_mirrored_observation_is_that_of_the_mirrored_push(frame):
    """Physics is left out: two pushes past a corner differ more than their sides."""
    history = PushHistory(frame)

    def remember(states):
        td = history._reset(states[0], states[0].clone())
        for state in states[1:]:
            td = history._step(td, state.clone())
        return td

    states = [make_state(4, seed) for seed in range(4)]
    for state in states:
        state["action"] = make_state(4, 9)["last_action"]
    one, other = remember(states), remember([mirrored(state) for state in states])
    assert one["history"].any()
    seen = MirroredObservation(frame, entries=["history"])(
        one.set("mirrored_latent", one["latent"])
    )
    expected = PushObservation(frame, entries=["history"])(other.clone())["observation"]
    torch.testing.assert_close(seen["mirrored_observation"], expected, atol=1e-4, rtol=1e-4)
    plain = PushObservation(frame, entries=["history"])(one.clone())["observation"]
    assert (plain - expected).abs().max() > 0.1


def test_a_whole_stack_has_the_history_and_its_mirror_image():
    config = PushEnvConfig.preset("cpu", num_envs=2, encoder="none", add=("history",), scene="free")
    env = make_push_env(config, mirrored=True, seed=3)
    check_env_specs(env)
    assert any(isinstance(t, PushHistory) for t in env.transform)
    env.close()
    env = make_push_env(config.with_fields(add=()), seed=3)
    assert "history" not in env.observation_spec.keys()
    env.close()


def test_the_entry_turns_with_the_agent_s_frame():
    env = make(1, "object")
    td = push(env, env.reset(scenarios=[BEHIND]), 5, torch.tensor([[0.0, -0.5, 0.0]]))
    env.close()
    in_object = PushObservation("object", entries=["history"], raw=True)(td.clone())["observation"]
    torch.testing.assert_close(in_object, td["history"].flatten(-2), atol=1e-6, rtol=0)
    in_base = PushObservation("base", entries=["history"], raw=True)(td.clone())["observation"]
    torch.testing.assert_close(in_base[0, 2:4], torch.tensor([0.5, 0.0]), atol=0.02, rtol=0)
