import pytest
import torch
from mani_skill.agents.registration import REGISTERED_AGENTS

from modpush.envs.engines.sapien.maniskill_task import ClutterPushEnv
from modpush.envs.robot.named import ROBOTS, TOOLS
from modpush.envs.robot.urdf import urdf_text
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


def test_urdf_has_no_visuals_since_sapien_refuses_them_without_a_renderer() -> None:
    text = urdf_text(ROBOTS["ur5"], TOOLS["2f85"])
    assert "<visual" not in text
    assert "<material" not in text


def test_the_robot_is_a_ur5_with_a_gripper(task) -> None:
    robot = task.agent.robot
    assert {"ur5_2f85", "ur5_rod"} <= set(REGISTERED_AGENTS)
    assert robot.active_joints[0].name == "shoulder_pan"
    masses = {link.name: float(link.mass[0]) for link in robot.links}
    for link in ROBOTS["ur5"].links:
        assert masses[link.name] == pytest.approx(link.mass)
    assert masses["tool"] == pytest.approx(0.9)
    # SAPIEN's loader drops the file's limits; the drives must have them all the same.
    limits = [joint._objs[0].force_limit for joint in robot.active_joints]
    assert limits == pytest.approx([joint.effort for joint in ROBOTS["ur5"].joints])


def test_the_rod_reaches_down_as_far_as_the_gripper() -> None:
    task = ClutterPushEnv(obs_mode="none", robot_uids="ur5_rod")
    task.reset(options={"scenarios": [scenario((0.5, 0.1, 0.0))]})
    assert float(task.agent.robot.links_map["tip"].pose.p[0, 2]) == pytest.approx(0.02, abs=1e-4)
    assert torch.isfinite(task.ee_pose).all()
    task.close()
