"""`modpush train` runs a preset with changed options."""

import subprocess
import sys

import pytest
import torch
import yaml

from modpush.cli import train
from modpush.training.learner import Learner
from modpush.training.run_folder import RunFolder

TERM = """
def large_actions(outcome):
    return -outcome["action"].square().sum(-1, keepdim=True)
"""


def test_a_run_from_the_command_line(tmp_path) -> None:
    command = [sys.executable, "-m", "modpush", "train", "smoke", "--out", "run"]
    command += ["--train.total-steps", "96", "--train.seed", "3"]
    command += ["--reward-term", "calm:large_actions", "0.2"]
    (tmp_path / "calm.py").write_text(TERM)
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "Best on the held-out episodes: success" in done.stdout
    folder = tmp_path / "run"
    config = yaml.safe_load((folder / "config.yaml").read_text())
    assert config["seed"] == 3
    assert config["env"]["reward"]["weights"]["calm:large_actions"] == 0.2
    assert (folder / "best_agent.safetensors").is_file()
    assert (folder / "curve.png").is_file()


@pytest.mark.parametrize("with_checkpoint", [False, True])
def test_an_interrupt_says_whether_there_is_a_checkpoint(
    tmp_path, monkeypatch, capsys, with_checkpoint
) -> None:
    def interrupted(run: train.RunConfig) -> None:
        if with_checkpoint:
            RunFolder(run.out).checkpoints.save(8, {"config": {}})
        raise KeyboardInterrupt

    monkeypatch.setattr(train, "train_agent", interrupted)
    with pytest.raises(KeyboardInterrupt):
        train.main(["smoke", "--out", str(tmp_path / "run")])
    expected = "a checkpoint is in" if with_checkpoint else "before the first checkpoint"
    assert expected in capsys.readouterr().out


def test_updates_run_on_as_many_threads_as_asked_for(tmp_path, monkeypatch) -> None:
    seen = set()
    learn = Learner.learn

    def counted(learner: Learner, before: int, now: int) -> None:
        seen.add(torch.get_num_threads())
        learn(learner, before, now)

    monkeypatch.setattr(Learner, "learn", counted)
    before = torch.get_num_threads()
    try:
        train.main(
            ["smoke", "--out", str(tmp_path / "run"), "--train.total-steps", "96", "--threads", "2"]
        )
    finally:
        torch.set_num_threads(before)
    assert seen == {2}
