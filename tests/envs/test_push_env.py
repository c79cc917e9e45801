import functools
from dataclasses import replace

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import check_env_specs

from modpush.envs import OBJECTS, PushEnv, ScenarioConfig
from modpush.envs.engines.base import CONTACT_GAP
from modpush.envs.engines.sapien.maniskill_task import ClutterPushEnv
from modpush.envs.scenes.drawing import draw_top_view
from modpush.envs.scenes.layouts import OBSTACLE_SCENES
from modpush.envs.scenes.objects import PAPER_OBJECTS, get_object
from modpush.envs.scenes.obstacle import Obstacle
from modpush.geometry.camera import CAMERA
from tests.envs.engines.sapien.test_agent import scenario

make_small = functools.partial(PushEnv, 2, scene="slot", depth=None)


def act(env: PushEnv, td: TensorDict, *action: float) -> TensorDict:
    td = td.clone()
    td["action"] = torch.tensor(action or (0.0, 0.0, 0.0)).expand(*env.batch_size, 3)
    return env.step(td)["next"]


def test_specs(env) -> None:
    check_env_specs(env, break_when_any_done="both")


@pytest.mark.parametrize(
    "kwargs",
    [
        {"depth": None},
        {"dynamic_obstacles": True, "scene": "posts"},
        {"arm_in_depth": True},
        {"tool": "rod", "oob": "terminate", "max_episode_steps": None},
        {"pushed_object": tuple(OBJECTS), "scene": OBSTACLE_SCENES, "sim_freq": 240},
    ],
)
def test_specs_under_other_options(kwargs) -> None:
    env = PushEnv(2, **kwargs)
    check_env_specs(env, break_when_any_done="both")
    env.close()


def test_every_key_of_the_docstring_is_emitted_and_no_other() -> None:
    options = {"dynamic_obstacles": True, "obstacle_motion": True, "object_dynamics": True}
    env = PushEnv(1, goal="pose", **options)
    said = {
        line.split()[0]
        for line in PushEnv.__doc__.split("meaning")[1].splitlines()
        if line.startswith(" " * 4) and not line.startswith(" " * 5) and "`[B" in line
    }
    state = env.rand_step(env.reset())
    emitted = set(state["next"].keys()) | {"action"}
    env.close()
    assert said == emitted


def test_each_scene_emits_the_radii_and_the_symmetry_of_its_own_object() -> None:
    env = PushEnv(len(PAPER_OBJECTS), pushed_object=tuple(PAPER_OBJECTS), depth=None)
    td = env.reset(scenarios=[scenario((0.4, 0.1, 0.0), name=name) for name in PAPER_OBJECTS])
    for state in (td, act(env, td)):
        # Cube, oblong, cylinder, fragment; half the diagonals of 5 x 5 and 8 x 5 cm.
        assert state["object_symmetry"].tolist() == [[4.0], [2.0], [0.0], [1.0]]
        torch.testing.assert_close(
            state["object_radius"][:3], torch.tensor([[0.0353553], [0.0471699], [0.03]])
        )
        for row, name in zip(state["object_support"], PAPER_OBJECTS, strict=True):
            item = OBJECTS[name]
            torch.testing.assert_close(row, torch.from_numpy(item.support).float())
        torch.testing.assert_close(
            state["object_inscribed_radius"][:3], torch.tensor([[0.025], [0.025], [0.03]])
        )
    widths = env.reset(scenarios=[scenario((0.4, 0.1, 0.0), name=n) for n in PAPER_OBJECTS])
    assert (widths["tool_half_extents"] == torch.tensor([0.032, 0.011])).all()
    bar = (Obstacle((0.05, 0.05, 0.06), (0.6, -0.2, 0.0)),)
    starts = [scenario((0.4, 0.1, 0.0), name=n, obstacles=bar) for n in PAPER_OBJECTS]
    wide = env.reset(scenarios=starts)["tool_half_extents"]
    expected = torch.tensor([[0.032, 0.011]] * 3 + [[0.062, 0.0135]])  # the fragment is flat
    assert torch.equal(wide, expected)
    flat, cylinder = env.get_state([3]), env.get_state([2])
    env.reset(scenarios=[scenario((0.4, 0.1, 0.0))] * len(PAPER_OBJECTS))
    assert torch.equal(env.set_state(flat, [1])["tool_half_extents"], expected[[0, 3, 0, 0]])
    env.reset(scenarios=[scenario((0.4, 0.1, 0.0))] * len(PAPER_OBJECTS))
    symmetry = env.set_state(cylinder, [1])["object_symmetry"]
    assert symmetry.tolist() == [[4.0], [0.0], [4.0], [4.0]]
    env.close()


def test_partial_reset_leaves_the_others_alone(env) -> None:
    td = env.reset()
    for _ in range(3):
        td = act(env, td, 0.5, 0.5, 0.0)
    mask = torch.tensor([[False], [True], [False]])
    after = env.reset(td.clone().set("_reset", mask))
    for key in env.observation_spec.keys():
        assert torch.equal(after[key][[0, 2]], td[key][[0, 2]]), key
    assert not torch.equal(after["object_pose"][1], td["object_pose"][1])
    counts = env._step_count.tolist()
    assert counts == [3, 0, 3]


def test_scene_i_draws_the_same_episodes_in_a_batch_of_any_size() -> None:
    many, one = PushEnv(3, scene="posts", depth=None), PushEnv(1, scene="posts", depth=None)
    many.set_seed(5)
    one.set_seed(5 + 2)
    for _ in range(3):
        many.reset()
        one.reset()
        assert many.scenarios[2] == one.scenarios[0]
    assert len({s.object_pose for s in many.scenarios}) == 3
    many.close()
    one.close()


# tests/envs/test_determinism.py has every object.


def test_set_state_shows_what_was_there(env) -> None:
    td = act(env, env.reset(), 1.0, 0.0, 0.0)
    state = env.get_state()
    env.reset()
    back = env.set_state(state)
    for key in env.observation_spec.keys():
        # PhysX computes the links' poses anew from the joints: they may differ in the last bit.
        torch.testing.assert_close(back[key], td[key], atol=1e-6, rtol=1e-6)
    # and the next episodes are the same as well: the randomness belongs to the state
    first = (env.reset(), env.scenarios)[1]
    env.set_state(state)
    env.reset()
    assert env.scenarios == first


def test_state_of_movable_obstacles_is_restored() -> None:
    env = PushEnv(1, scene="posts", dynamic_obstacles=True, depth=None, seed=0)
    wall = (Obstacle((0.05, 0.05, 0.05), (0.56, 0.0, 0.0)),) * 1
    td = env.reset(scenarios=[scenario((0.48, 0.0, np.pi / 2), obstacles=wall)])
    for _ in range(6):
        td = act(env, td, 1.0, 0.0, 0.0)
    assert td["obstacle_displacement"][0, 0] > 0.03
    state = env.get_state()
    env.reset()
    back = env.set_state(state)
    assert torch.equal(back["obstacle_displacement"], td["obstacle_displacement"])
    env.close()


def test_some_scenes_can_be_put_back_while_others_continue(env) -> None:
    td = env.reset()
    state = env.get_state([1])
    td = act(env, td, 1.0, 0.0, 0.0)
    mixed = env.set_state(state, [1])
    assert torch.equal(mixed["ee_pose"][[0, 2]], td["ee_pose"][[0, 2]])
    assert not torch.equal(mixed["ee_pose"][1], td["ee_pose"][1])
    with pytest.raises(ValueError, match="the state holds 1 scenes, expected 3"):
        env.set_state(state)


def test_it_steps_as_the_maniskill_task_does() -> None:
    where = scenario((0.42, 0.02, 0.3), (0.52, 0.0, 0.4), goal_position=(0.65, 0.2))
    task, env = ClutterPushEnv(obs_mode="none"), PushEnv(1, depth=None)
    task.reset(options={"scenarios": [where]})
    td = env.reset(scenarios=[where])
    rng = np.random.default_rng(0)
    for _ in range(25):
        action = np.clip(rng.normal([0.8, 0, 0], 0.5), -1, 1).astype(np.float32)
        *_, info = task.step(action)
        td = act(env, td, *action.tolist())
        # The ways differ in a rounding (float32 targets here, float64 there), which contact amplifies.
        np.testing.assert_allclose(td["object_pose"], task.object_pose, atol=2e-4)
        np.testing.assert_allclose(td["ee_pose"], task.ee_pose, atol=2e-4)
        for key in ("object_contact", "obstacle_contact", "tool_obstacle_contact", "success"):
            assert bool(td[key]) == bool(info[key]), key
    task.close()
    env.close()


def test_contact_at_a_step_s_end_is_what_physics_shows_then() -> None:
    env = PushEnv(1, depth=None)
    where = scenario((0.42, 0.0, np.pi / 2), (0.52, 0.0, 0.0), goal_position=(0.72, 0.2))
    td = env.reset(scenarios=[where])
    task = env._batch.engines[0].task
    body = task.objects.actors["small_cube"]._bodies[0]
    robot = {link._objs[0] for link in task.agent.robot.links}
    during, at_end = [], []
    for step in range(24):
        td = act(env, td, 1.0 if step % 4 < 3 else -0.6, 0.0, 0.0)  # pushes, and lets go
        touching = any(
            point.separation <= CONTACT_GAP or (point.separation <= 0.005 and point.impulse.any())
            for contact in task.scene.px.get_contacts()
            if body in contact.bodies and robot.intersection(contact.bodies)
            for point in contact.points
        )
        during.append(bool(td["object_contact"]))
        at_end.append(bool(td["object_contact_at_end"]))
        assert at_end[-1] == touching
    assert all(a or not b for a, b in zip(during, at_end, strict=True))
    assert 0 < sum(at_end) <= sum(during) < 24
    kept = env.get_state()
    assert bool(env.reset(state=kept)["object_contact_at_end"]) == at_end[-1]
    env.close()


def test_success_terminates_with_reward_one() -> None:
    env = PushEnv(1, depth=None)
    where = scenario((0.40, 0.0, np.pi / 2), (0.50, 0.0, 0.0), goal_position=(0.60, 0.0))
    td = env.reset(scenarios=[where])
    rewards = []
    while not td["done"].any():
        td = act(env, td, 1.0, 0.0, 0.0)
        rewards.append(td["reward"].item())
    assert rewards[-1] == 1.0
    assert not any(rewards[:-1])
    assert td["success"].all()
    assert td["terminated"].all()
    assert not td["truncated"].any()
    env.close()


@pytest.mark.parametrize(("oob", "key"), [("truncate", "truncated"), ("terminate", "terminated")])
def test_leaving_the_workspace(oob, key) -> None:
    env = PushEnv(1, depth=None, oob=oob)
    td = env.reset(
        scenarios=[scenario((0.62, 0.0, np.pi / 2), (0.72, 0.0, 0.0), goal_position=(0.3, 0))]
    )
    while not td["done"].any():
        td = act(env, td, 1.0, 0.0, 0.0)
    assert td["out_of_bounds"].all()
    assert td["object_pose"][0, 0] > 0.80
    assert td[key].all()
    env.close()


def test_the_scene_distribution_can_be_changed_between_episodes(env) -> None:
    before = env.scenario
    env.scenario = ScenarioConfig(scene="posts", distance=(0.06, 0.08))
    env.reset()
    assert {s.scene for s in env.scenarios} == {"posts"}
    for s in env.scenarios:
        assert np.hypot(*np.subtract(s.goal_position, s.object_pose[:2])) < 0.08
    env.scenario = before


def test_the_object_is_where_its_pose_says_in_the_image(env) -> None:
    td = env.reset()
    for i in range(3):
        v, u = np.nonzero(td["segmentation"][i, 0].numpy() == 1)
        x, y, _ = td["object_pose"][i].tolist()
        expected = CAMERA.project(np.array([x, y]), 0.04)
        assert [u.mean(), v.mean()] == pytest.approx(expected, abs=1.5)


def test_the_arm_is_in_the_image_only_where_asked_for() -> None:
    for arm in (False, True):
        env = PushEnv(1, arm_in_depth=arm, seed=0)
        assert (env.reset()["segmentation"] == 3).any() == arm
        env.close()


def test_images_that_are_held_stay_as_they_were(env) -> None:
    # Their memory is used again, but not before the last view of it is gone.
    td = env.reset()
    held, copies = [], []
    for step in range(7):
        td = act(env, td, 1.0, 0.5 - 0.2 * step, 0.0)
        held.append((td["depth"][1:], td["segmentation"].numpy()))
        copies.append(tuple(np.asarray(image).copy() for image in held[-1]))
    for images, before in zip(held, copies, strict=True):
        for image, copy in zip(images, before, strict=True):
            np.testing.assert_array_equal(image, copy)
    places = {images[0].data_ptr() for images in held}
    del held, images, image
    td = act(env, td)
    assert td["depth"][1:].data_ptr() in places


def test_memory_does_not_grow_with_episodes() -> None:
    import psutil

    env = PushEnv(2, scene=OBSTACLE_SCENES, pushed_object=tuple(OBJECTS), seed=0)
    process = psutil.Process()
    for _ in range(50):
        env.reset()
    before = process.memory_info().rss
    for _ in range(200):
        env.reset()
    env.close()
    assert process.memory_info().rss - before < 20e6


@pytest.mark.parametrize(
    ("action", "message"),
    [
        ([float("nan"), 0, 0], r"action of scene 1 must be finite and in \[-1, 1\]"),
        ([0, 1.5, 0], r"action of scene 1 must be .* got \[0.0, 1.5, 0.0\]"),
    ],
)
def test_bad_actions_are_refused_with_the_scenes_index(env, action, message) -> None:
    td = env.reset()
    td["action"] = torch.zeros(3, 3)
    td["action"][1] = torch.tensor(action)
    with pytest.raises(ValueError, match=message):
        env.step(td)


def test_closing_frees_the_simulators_once_and_for_all() -> None:
    env = make_small()
    td = env.rand_step(env.reset())
    state = env.get_state()
    assert not env.is_closed
    env.close()
    assert env.is_closed
    assert not env._batch.engines
    env.close()  # a second time does nothing
    uses = {
        "step": lambda: env.step(td),
        "reset": env.reset,
        "render": env.render,
        "get_state": env.get_state,
        "set_state": lambda: env.set_state(state),
        "scenarios": lambda: env.scenarios,
    }
    for name, use in uses.items():
        with pytest.raises(
            RuntimeError, match=rf"PushEnv\.{name}: the environment has been closed"
        ):
            use()


def test_render_draws_each_scene_from_above_where_there_is_no_renderer() -> None:
    env = PushEnv(2, scene="posts", dynamic_obstacles=True, depth=None, seed=0)
    state = env.reset()
    first, second = env.render(), env.render(1)
    assert (first != second).any()
    objects, tools = state["object_pose"].tolist(), state["ee_pose"].tolist()
    for picture, start, pose, tool in zip(
        (first, second), env.scenarios, objects, tools, strict=True
    ):
        np.testing.assert_array_equal(picture, draw_top_view(start, pose, tool))
    env.close()


def test_a_refused_reset_changes_no_scene() -> None:
    env = PushEnv(2, depth=None, seed=0)
    env.reset()
    env.step(env.rand_action())
    before = env.get_state()
    first, second = env.scenarios
    far_away = replace(second, tool_pose=(3.0, 3.0, 0.0))
    with pytest.raises(ValueError, match="tool_pose"):
        env.reset(scenarios=[replace(first, goal_position=(0.5, 0.2)), far_away])
    assert env.get_state().to_dict() == before.to_dict()
    env.close()


def test_a_scenario_that_the_environment_was_not_made_for_is_refused(env) -> None:
    with pytest.raises(ValueError, match="scenario must keep low and high"):
        env.scenario = replace(env.scenario, low=(0.3, -0.3))
    with pytest.raises(ValueError, match=r"scenario must have objects of .*got \['random_1'\]"):
        env.scenario = replace(env.scenario, pushed_object="random_1")
    name = env.scenario.objects[0].name
    other_shape = replace(get_object("random_1"), name=name)
    with pytest.raises(ValueError, match=f"got .'{name}'.*"):
        env.scenario = replace(env.scenario, pushed_object=other_shape)


def test_a_refused_reset_leaves_the_random_numbers_alone() -> None:
    draws = []
    for refused in (False, True):
        env = PushEnv(2, scene="slot", depth=None, seed=3)
        td = env.reset()
        if refused:
            td["_reset"] = torch.tensor([[True], [False]])
            with pytest.raises((TypeError, ValueError)):
                env.reset(td, scenarios=["no scenario"], seed=77)
        draws.append(env.reset()["goal_position"])
        env.close()
    assert torch.equal(*draws)
