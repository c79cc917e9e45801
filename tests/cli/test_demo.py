"""`modpush demo` writes what it says, on two families and one episode each."""

import cv2
import numpy as np
import pytest

from modpush.cli import demo, run_command
from modpush.cli.demo import DemoConfig, _draw_scenarios, show_demo
from modpush.envs.scenes.rectangles import crosses_rectangle, rectangles, turned_rectangles
from modpush.envs.scenes.shape_layouts import SHAPE_SCENES
from modpush.evaluation import run_episodes
from modpush.recipes import load_agent


def test_demo(tmp_path, capsys) -> None:
    command = ["demo", "--episodes", "1", "--out", str(tmp_path), "--scenes", "free", "posts"]
    command += ["--no-rendered"]
    assert run_command(command) == 0
    assert "| scene | policy | success | contact_rate | collision_rate |" in capsys.readouterr().out
    assert (tmp_path / "table.md").read_text().count("\n") == 6
    for name in ("free", "posts"):
        assert cv2.imread(str(tmp_path / f"{name}.png")).std() > 10
    video = cv2.VideoCapture(str(tmp_path / "demo.mp4"))
    frames = 0
    while video.read()[0]:
        frames += 1
    assert frames > 20


def test_the_demo_runs_with_another_engine_robot_and_tool(tmp_path, capsys, monkeypatch) -> None:
    used = []

    def run(env, *given, **options):
        used.append((env.base_env.engine_name, env.base_env.robot.name, env.base_env.tool.name))
        return run_episodes(env, *given, **options)

    monkeypatch.setattr(demo, "run_episodes", run)
    parts = {"engine": "mujoco", "robot": "ur10", "tool": "rod"}
    show_demo(DemoConfig(policy=("scripted",), scenes=("free",), episodes=1, out=tmp_path, **parts))
    assert used == [("mujoco", "ur10", "rod")]
    assert f"({tmp_path / 'arm.mp4'}, from the side), table.md" in capsys.readouterr().out
    found, frame = cv2.VideoCapture(str(tmp_path / "arm.mp4")).read()
    assert found
    assert (frame.shape, frame.std() > 10) == ((512, 512, 3), True)


@pytest.mark.parametrize("wrong", [{"robot": "kuka"}, {"tool": "spoon"}])
def test_an_unknown_robot_or_tool_ends_the_demo_before_an_episode(tmp_path, wrong) -> None:
    with pytest.raises(ValueError, match=f"{next(iter(wrong))}: there is no"):
        show_demo(DemoConfig(out=tmp_path, **wrong))


def test_goal_poses_are_shown_past_an_obstacle_in_the_way() -> None:
    config = DemoConfig(goal="pose", episodes=1).filled()
    assert config.policy == ("pose",)
    drawn = {s.scene: s for s in _draw_scenarios(config)}
    assert {s.pushed_object for s in drawn.values()} == {*config.pushed_object}
    assert {*config.pushed_object} < {*load_agent("pose").config.scenario.pushed_object}
    assert [*drawn] == ["free", *SHAPE_SCENES]
    assert all(s.goal_yaw is not None for s in drawn.values())
    for scene in SHAPE_SCENES:
        s = drawn[scene]
        boxes = turned_rectangles(rectangles(s.obstacles))
        assert crosses_rectangle(np.array(s.object_pose[:2]), np.array(s.goal_position), boxes)
