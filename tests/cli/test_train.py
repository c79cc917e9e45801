"""`modpush train` runs a preset with changed options."""

import subprocess
import sys

import yaml


def test_a_run_from_the_command_line(tmp_path) -> None:
    command = [sys.executable, "-m", "modpush", "train", "smoke", "--out", "run"]
    command += ["--train.total-steps", "96", "--train.seed", "3"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "Best on the held-out episodes: success" in done.stdout
    folder = tmp_path / "run"
    assert yaml.safe_load((folder / "config.yaml").read_text())["seed"] == 3
    assert (folder / "best_agent.safetensors").is_file()
    assert (folder / "curve.png").is_file()
