import numpy as np
import pytest
import torch
from mani_skill.agents.registration import REGISTERED_AGENTS

from modpush.envs.engines.sapien.task import ClutterPushEnv
from modpush.envs.robot.ur5_2f85 import FORCE_LIMIT, LINKS, TOOLS, urdf_path, urdf_text
from modpush.envs.scenes.objects import OBJECTS
from modpush.envs.scenes.scenario import Scenario

TABLE_ONLY = {"scene": "free", "difficulty": 0.0, "obstacles": ()}


def scenario(tool_pose, object_pose=(0.25, -0.30, 0.0), name="small_cube", **changes) -> Scenario:
    fields = {
        **TABLE_ONLY,
        "pushed_object": name,
        "object_pose": object_pose,
        "goal_position": (0.5, 0.0),
        "tool_pose": tool_pose,
        **changes,
    }
    return Scenario(**fields)


@pytest.mark.parametrize("tool", sorted(TOOLS))
def test_shipped_urdf_is_what_the_tables_say(tool) -> None:
    assert urdf_path(tool).read_text() == urdf_text(tool)


def test_urdf_has_no_visuals_since_sapien_refuses_them_without_a_renderer() -> None:
    assert "<visual" not in urdf_text("2f85")
    assert "<material" not in urdf_text("2f85")


def test_the_robot_is_a_ur5_with_a_gripper(task) -> None:
    robot = task.agent.robot
    assert {"ur5_2f85", "ur5_rod"} <= set(REGISTERED_AGENTS)
    assert robot.active_joints[0].name == "shoulder_pan"
    masses = {link.name: float(link.mass[0]) for link in robot.links}
    for link in LINKS:
        assert masses[link.name] == pytest.approx(link.mass)
    assert masses["tool"] == pytest.approx(0.9)
    # SAPIEN's loader drops the file's limits; the drives must have them all the same.
    limits = [joint._objs[0].force_limit for joint in robot.active_joints]
    assert limits == pytest.approx(FORCE_LIMIT)


@pytest.mark.parametrize("sim_freq", [120, 240])
def test_the_tip_follows_at_15_hz_within_2_mm(sim_freq) -> None:
    task = ClutterPushEnv(obs_mode="none", sim_freq=sim_freq)
    rng = np.random.default_rng(0)
    worst, heights = 0.0, []
    for start in ((0.45, -0.25, 0.0), (0.65, 0.20, 1.0), (0.30, 0.20, -1.0)):
        task.reset(options={"scenarios": [scenario(start)]})
        for _ in range(4):  # four straight legs at full speed, turning all the while
            action = np.array([*rng.choice([-1.0, 1.0], 2), rng.choice([-1.0, 1.0])], np.float32)
            for _ in range(8):
                task.step(action)
                error = task.ee_pose - task.agent.controller.target
                worst = max(worst, float(error[0, :2].norm()))
                assert abs(float(error[0, 2])) < 0.02
                heights.append(float(task.agent.robot.links_map["tip"].pose.p[0, 2]))
    task.close()
    assert worst < 0.002
    assert max(abs(h - 0.02) for h in heights) < 0.001


@pytest.mark.parametrize("name", sorted(OBJECTS))
def test_the_tip_stands_at_the_height_that_suits_the_object(task, name) -> None:
    task.reset(options={"scenarios": [scenario((0.5, 0.1, 0.0), name=name)]})
    height = float(task.agent.robot.links_map["tip"].pose.p[0, 2])
    assert height == pytest.approx(OBJECTS[name].tool_height, abs=1e-4)
    assert 0.012 <= OBJECTS[name].tool_height <= 0.02


def test_the_rod_reaches_down_as_far_as_the_gripper() -> None:
    task = ClutterPushEnv(obs_mode="none", robot_uids="ur5_rod")
    task.reset(options={"scenarios": [scenario((0.5, 0.1, 0.0))]})
    assert float(task.agent.robot.links_map["tip"].pose.p[0, 2]) == pytest.approx(0.02, abs=1e-4)
    assert torch.isfinite(task.ee_pose).all()
    task.close()
