import json

import gymnasium as gym
import numpy as np
import pytest
import torch

from modpush.envs import PushEnv  # also registers the task
from modpush.envs.engines.sapien.maniskill_task import ClutterPushEnv
from modpush.envs.engines.sapien.rendering import NO_RENDERER, find_render_device
from modpush.envs.scenes.layouts import SCENES
from modpush.envs.scenes.objects import PushedObject
from modpush.envs.scenes.obstacle import OBSTACLE_MASS, Obstacle
from modpush.envs.scenes.scenario import Dynamics, ScenarioConfig
from modpush.geometry import box, centered
from tests.envs.engines.sapien.test_agent import scenario

PUSH_X = np.array([1.0, 0.0, 0.0], np.float32)
STILL = np.zeros(3, np.float32)


def start(task: ClutterPushEnv, *args, **kwargs) -> None:
    task.reset(options={"scenarios": [scenario(*args, **kwargs)]})


def test_gym_make_in_maniskills_usual_way() -> None:
    env = gym.make("ClutterPush-v1", scene="slot", obs_mode="state_dict")
    observation, info = env.reset(seed=0)
    assert observation["extra"]["object_pose"].shape == (1, 3)
    assert observation["agent"]["qpos"].shape == (1, 6)
    assert not info["success"].any()
    truncated = False
    steps = 0
    while not truncated:
        steps += 1
        _, reward, terminated, truncated, _ = env.step(STILL)
        assert not terminated.any()
        assert reward.item() == 0
    assert steps == 200
    assert env.action_space.shape == (3,)
    env.close()


@pytest.mark.parametrize("mode", ["pd_joint_pos", "pd_joint_delta_pos"])
def test_maniskills_joint_controllers_turn_the_arm_s_joints(mode) -> None:
    env = gym.make("ClutterPush-v1", obs_mode="state_dict", control_mode=mode)
    env.reset(options={"scenarios": [scenario((0.45, 0.1, 0.0))]})
    before = env.unwrapped.agent.robot.get_qpos()[0].clone()
    turn = np.array([0.05, 0, 0, 0, 0, 0], np.float32)  # a delta of 1 is 0.05 rad
    env.step(before.numpy() + turn if mode == "pd_joint_pos" else turn / 0.05)
    for _ in range(9):
        env.step(before.numpy() + turn if mode == "pd_joint_pos" else 0 * turn)
    after = env.unwrapped.agent.robot.get_qpos()[0]
    np.testing.assert_allclose(after - before, turn, atol=2e-3)
    env.close()


def test_out_of_bounds_by_5_cm_truncates_under_gym_make() -> None:
    env = gym.make("ClutterPush-v1", obs_mode="state_dict")
    where = scenario((0.60, 0.0, np.pi / 2), (0.72, 0.0, 0.0), goal_position=(0.3, 0.0))
    env.reset(options={"scenarios": [where]})
    for _ in range(30):
        _, _, terminated, truncated, info = env.step(PUSH_X)
        x = env.unwrapped.object_pose[0, 0].item()
        assert bool(info["out_of_bounds"]) == (x > 0.80)
        assert not terminated.any()
        if truncated.any():
            break
    assert x > 0.80
    env.close()


def test_collisions_of_object_and_of_tool_are_told_apart() -> None:
    task = ClutterPushEnv(obs_mode="none")
    wall = (Obstacle((0.40, 0.06, 0.06), (0.60, 0.0, np.pi / 2)),)
    # The object between tool and wall: only the object meets the wall.
    start(task, (0.40, 0.0, np.pi / 2), (0.50, 0.0, 0.0), obstacles=wall)
    for _ in range(12):
        *_, info = task.step(PUSH_X)
    assert info["obstacle_contact"].all()
    assert not info["tool_obstacle_contact"].any()
    # The tool alone: only the tool does.
    start(task, (0.48, 0.0, np.pi / 2), (0.30, -0.25, 0.0), obstacles=wall)
    for _ in range(8):
        *_, info = task.step(PUSH_X)
    assert info["tool_obstacle_contact"].all()
    assert not info["obstacle_contact"].any()
    assert not info["object_contact"].any()
    task.close()


@pytest.mark.parametrize("fraction", [0.8, 0.9, 1.1, 1.2])
def test_the_object_begins_to_slide_at_its_friction(fraction) -> None:
    """Object-table 0.5: 1 kg gives way at 0.5 * 9.81 N, which is the mean of the two materials."""
    task = ClutterPushEnv(obs_mode="none")
    start(task, (0.3, 0.3, 0.0), (0.5, -0.1, 0.0))
    for _ in range(3):
        task.step(STILL)  # settle
    body = task.objects.actors["small_cube"]._bodies[0]
    before = task.object_pose[0, 0].item()
    force = np.array([fraction * 0.5 * 9.81, 0.0, 0.0], np.float32)
    for _ in range(task.sim_freq):  # one second
        low_down = body.entity_pose.p - [0, 0, 0.02]  # or the cube would tip over first
        body.add_force_at_point(force, low_down.astype(np.float32))
        task.scene.step()
    moved = task.object_pose[0, 0].item() - before
    expected = max(fraction - 1, 0.0) * 0.5 * 9.81 / 2  # a t^2 / 2
    assert moved == pytest.approx(expected, rel=0.02, abs=1e-3)
    task.close()


def test_randomised_dynamics_reach_physics() -> None:
    task = ClutterPushEnv(obs_mode="none", scenario=ScenarioConfig(randomize_dynamics=True))
    start(
        task, (0.4, 0.1, 0.0), dynamics=Dynamics(mass=0.4, friction=0.8, center_of_mass=(0.01, 0))
    )
    body = task.objects.actors["small_cube"]._bodies[0]
    assert body.mass == pytest.approx(0.4)
    assert body.inertia == pytest.approx([0.4 * 0.05**2 / 6] * 3, rel=1e-3)  # of a solid cube
    assert body.cmass_local_pose.p == pytest.approx([0.01, 0, 0])
    assert task.objects.material.static_friction == pytest.approx(0.8)
    start(task, (0.4, 0.1, 0.0))
    assert body.mass == pytest.approx(1.0)
    task.close()


def test_the_centre_of_mass_of_unequal_parts_keeps_its_height() -> None:
    parts = centered(box(0.06, 0.06, 0.02), box(0.02, 0.02, 0.06, (0.0, 0.0, 0.04)))
    task = ClutterPushEnv(
        obs_mode="none", pushed_object=PushedObject(name="pawn", parts=parts, symmetry=4)
    )
    task.reset(seed=0)
    body = task.objects.actors["pawn"]._bodies[0]
    masses = [0.06 * 0.06 * 0.02, 0.02 * 0.02 * 0.06]
    heights = [part.position[2] for part in parts]
    expected = np.average(heights, weights=masses)
    assert expected < -0.01
    assert body.cmass_local_pose.p == pytest.approx([0, 0, expected], abs=1e-5)
    task.close()


def test_layouts_change_from_episode_to_episode_without_rebuilding() -> None:
    task = ClutterPushEnv(obs_mode="none", scene=list(SCENES))
    scene = task.scene
    for seed in range(20):
        task.reset(seed=seed)
        standing = task.scenarios[0].obstacles
        assert len(task.obstacles.rigid_bodies()) == len(standing)
        expected = np.array([o.pose[:2] for o in standing]).reshape(-1, 2)
        np.testing.assert_allclose(task.obstacles.transforms()[:, :2], expected, atol=1e-5)
    assert task.scene is scene
    task.close()


def test_maniskill_state_round_trip() -> None:
    task = ClutterPushEnv(obs_mode="none", scene="posts", render_mode="none")
    assert task.render_mode is None
    task.reset(seed=3)
    rng = np.random.default_rng(0)
    for _ in range(10):
        task.step(rng.uniform(-1, 1, 3).astype(np.float32))
    state = task.get_state_dict()
    before = (task.object_transform.clone(), task.agent.controller.target.clone())
    for _ in range(5):
        task.step(PUSH_X)
    task.set_state_dict(state)
    torch.testing.assert_close(task.object_transform, before[0])
    torch.testing.assert_close(task.agent.controller.target, before[1])
    assert task.get_state().ndim == 2
    task.close()


def test_the_state_holds_movable_obstacles() -> None:
    task = ClutterPushEnv(obs_mode="none", dynamic_obstacles=True)
    bars = [Obstacle((0.05, 0.05, 0.05), (0.6, y, 0.0)) for y in (-0.2, 0.0, 0.2)]
    start(
        task, (0.45, 0.25, 0.0), obstacles=tuple(bars[:1])
    )  # ManiSkill's own record of the actors is of this episode
    start(task, (0.45, 0.25, 0.0), obstacles=tuple(bars))
    assert task.obstacles.rigid_bodies()[0].mass == pytest.approx(OBSTACLE_MASS)
    state, flat, before = task.get_state_dict(), task.get_state(), task.obstacles.transforms()
    task.obstacles.rigid_bodies()[1].linear_velocity = [0.0, 0.5, 0.0]
    task.step(STILL)
    moving, after = task.get_state_dict(), task.obstacles.transforms()
    assert np.linalg.norm(after - before, axis=-1) == pytest.approx([0, 0.02, 0], abs=0.015)
    for set_state, to in ((task.set_state_dict, state), (task.set_state, flat)):
        set_state(to)
        np.testing.assert_allclose(task.obstacles.transforms(), before, atol=1e-6)
        assert not np.any(task.obstacles.rigid_bodies()[1].linear_velocity)
        task.set_state_dict(moving)
        torch.testing.assert_close(task.get_state_dict()["actors"], moving["actors"])
    start(task, (0.45, 0.25, 0.0), obstacles=tuple(bars[:2]))
    with pytest.raises(
        ValueError, match=r"must have the movable obstacles .*obstacle_1'.*obstacle_2"
    ):
        task.set_state_dict(state)
    task.close()


def test_a_scenario_must_fit_the_task(task) -> None:
    with pytest.raises(ValueError, match="one Scenario for each of the 1 scenes being reset"):
        task.reset(options={"scenarios": [scenario((0.4, 0, 0))] * 2})
    with pytest.raises(ValueError, match="out of the arm's reach"):
        task.reset(options={"scenarios": [scenario((2.0, 0, 0))]})
    small = ClutterPushEnv(obs_mode="none")
    with pytest.raises(
        ValueError, match="'fragment' was not loaded, expected one of this environment's"
    ):
        small.reset(options={"scenarios": [scenario((0.4, 0, 0), name="fragment")]})
    small.close()


def test_pictures_without_a_renderer_say_how_to_get_one() -> None:
    if find_render_device() is not None:
        pytest.skip("there is a renderer")
    with pytest.raises(RuntimeError, match="No Vulkan device"):
        gym.make("ClutterPush-v1", obs_mode="rgbd")
    with pytest.raises(RuntimeError, match="No Vulkan device"):
        PushEnv(1, pictures=True)


def test_a_broken_vulkan_driver_does_not_take_the_process_down(tmp_path, monkeypatch) -> None:
    driver = tmp_path / "broken.so"
    driver.write_bytes(b"this is no library")
    icd = tmp_path / "broken.json"
    about = {"library_path": str(driver), "api_version": "1.3.0"}
    icd.write_text(json.dumps({"file_format_version": "1.0.0", "ICD": about}))
    monkeypatch.setenv("VK_ICD_FILENAMES", str(icd))
    monkeypatch.setenv("VK_DRIVER_FILES", str(icd))
    assert find_render_device() is None
    assert "make renderer" in NO_RENDERER
