"""`modpush demo` writes what it says, on two families and one episode each."""

import subprocess
import sys

import cv2

from modpush.cli.demo import DemoConfig, show_demo


def test_demo(tmp_path) -> None:
    command = [sys.executable, "-m", "modpush", "demo", "--episodes", "1"]
    command += ["--out", str(tmp_path), "--scenes", "free", "posts", "--no-rendered"]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=tmp_path)
    assert "| scene | policy | success | contact_rate | collision_rate |" in done.stdout
    assert (tmp_path / "table.md").read_text().count("\n") == 6
    for name in ("free", "posts"):
        assert cv2.imread(str(tmp_path / f"{name}.png")).std() > 10
    video = cv2.VideoCapture(str(tmp_path / "demo.mp4"))
    frames = 0
    while video.read()[0]:
        frames += 1
    assert frames > 20


def test_the_demo_runs_in_another_engine(tmp_path, capsys) -> None:
    show_demo(
        DemoConfig(
            policy=("scripted",), engine="mujoco", scenes=("free",), episodes=1, out=tmp_path
        )
    )
    assert "demo.mp4 (no arm.mp4), table.md" in capsys.readouterr().out
