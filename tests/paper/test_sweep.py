"""Sweeps: what they refuse, how they are resumed, and their tables."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from modpush.training import TRAIN_PRESETS, RunFolder
from paper.rows import ROOT
from paper.sweep import is_finished, load_trials
from paper.sweep_results import sweep_table

SWEEPS = ROOT / "paper" / "sweeps"


def write_sweep(path: Path, variants: str, head: str = "preset: smoke") -> Path:
    path.write_text(f"{head}\nvariants: {variants}\n", encoding="utf-8")
    return path


def test_overrides_reach_the_configuration(tmp_path: Path) -> None:
    file = write_sweep(
        tmp_path / "sweep.yaml",
        "[{name: a}, {name: b, overrides: {env.reward.weights.goal: 7.0, tqc.actor_lr: 3e-4}}]",
        "preset: smoke\nseeds: [3, 5]\noverrides: {total_steps: 96}",
    )
    trials = load_trials(file)
    assert [trial.name for trial in trials] == ["a/seed_3", "b/seed_3", "a/seed_5", "b/seed_5"]
    config = trials[3].config
    assert (config.seed, config.total_steps, config.tqc.actor_lr) == (5, 96, 3e-4)
    smoke = TRAIN_PRESETS["smoke"]
    assert config.env.reward.weights == {**smoke.env.reward.weights, "goal": 7.0}
    assert trials[0].config.env == smoke.env
    assert {trial.config.total_steps for trial in load_trials(file, total_steps=48)} == {48}


@pytest.mark.parametrize(
    ("name", "count"), [("ablations", 3 * 39), ("hard_further", 9), ("latent_sizes", 12)]
)
def test_the_sweeps_are_as_many_runs_as_their_files_say(name: str, count: int) -> None:
    trials = load_trials(SWEEPS / f"{name}.yaml")
    assert len(trials) == count
    configs = [repr(trial.config) for trial in trials]
    assert len(set(configs)) == len(configs)  # no variant changes nothing
    if name == "latent_sizes":
        assert trials[0].config == load_trials(SWEEPS / "ablations.yaml")[0].config


@pytest.mark.slow
def test_a_sweep_that_was_interrupted_continues(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "paper", "sweep", str(SWEEPS / "smoke.yaml")]
    command += ["--out", str(tmp_path / "out")]
    trials = load_trials(SWEEPS / "smoke.yaml")
    first = RunFolder(tmp_path / "out" / trials[0].name)
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    process = subprocess.Popen(command, env=env, cwd=ROOT)
    end = time.monotonic() + 600
    while first.checkpoints.latest() is None and time.monotonic() < end:
        assert process.poll() is None
        time.sleep(0.01)
    process.send_signal(signal.SIGTERM)
    assert process.wait(120) != 0
    assert not all(is_finished(trial, tmp_path / "out") for trial in trials)
    assert subprocess.run(command, env=env, cwd=ROOT, check=False).returncode == 0
    assert all(is_finished(trial, tmp_path / "out") for trial in trials)


def test_variants_are_compared_with_the_first_one() -> None:
    final = {"base": [0.95, 0.97, 0.99], "uniform": [0.90, 0.94, 0.92], "off": [0.1, 0.2, 0.3]}
    other = {"spl": 0.8, "contact_rate": 0.9, "collision_rate": 0.01, "minutes": 5.0}
    evaluations = pd.DataFrame(
        {"variant": v, "seed": s, "step": step, "success": value * step / 200, **other}
        for v, values in final.items()
        for s, value in enumerate(values)
        for step in (100, 200)
    ).assign(group=lambda frame: np.where(frame["variant"] == "base", "base", "others"))
    trials = evaluations[evaluations["step"] == 200].assign(
        finished=lambda frame: (frame["variant"] != "off") | (frame["seed"] < 2)
    )
    table = sweep_table(trials, evaluations).droplevel("group")
    assert table["success"].to_dict() == pytest.approx({"base": 0.97, "uniform": 0.92, "off": 0.15})
    assert table["seeds"].to_dict() == {"base": 3, "uniform": 3, "off": 2}
    assert table["area"]["uniform"] == pytest.approx(0.75 * 0.92)
    assert table["steps_to_0.9"].to_dict() == pytest.approx(
        {"base": 200, "uniform": 200, "off": np.nan}, nan_ok=True
    )
    expected = stats.ttest_rel(final["uniform"], final["base"]).pvalue
    assert table["p"]["uniform"] == pytest.approx(expected)
    assert table["difference"]["off"] == pytest.approx(-0.81)  # of the two seeds that are finished
    assert np.isnan(table[["p", "effect_size"]].loc["off"]).all()  # two seeds tell nothing
    assert np.isnan(table["difference"]["base"])
    with pytest.raises(ValueError, match="no trial of 'base', the first variant, is finished"):
        sweep_table(trials.assign(finished=False), evaluations)
