"""Sweeps: what they refuse, how they are resumed, and what they write."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import asdict, replace
from pathlib import Path

import pandas as pd
import pytest
import yaml

from modpush.sweeps import Sweep, Variant, load_sweep, run_sweep
from modpush.sweeps.results import trial_row
from modpush.sweeps.trial import TrialFailedError, check_end, start_trial
from modpush.training import TRAIN_PRESETS, RunFolder, Trainer
from tests.training.test_training import assert_same, numbers

ROOT = Path(__file__).parents[2]
SMOKE = ROOT / "examples" / "sweeps" / "smoke.yaml"
VARIANTS = [{"name": "rays"}, {"name": "none", "overrides": {"env.encoder": "none"}}]


def test_overrides_reach_the_configuration() -> None:
    sweep = Sweep(
        preset="smoke",
        overrides={"total_steps": 96},
        variants=(
            Variant(name="a"),
            Variant(name="b", overrides={"env.reward.weights.goal": 7.0, "tqc.hidden_sizes": [8]}),
        ),
        seeds=(3, 5),
    )
    trials = sweep.trials()
    assert [trial.name for trial in trials] == ["a/seed_3", "b/seed_3", "a/seed_5", "b/seed_5"]
    config = trials[3].config
    assert (config.seed, config.total_steps, config.tqc.hidden_sizes) == (5, 96, (8,))
    smoke = TRAIN_PRESETS["smoke"][1]
    assert config.env.reward.weights == {**smoke.env.reward.weights, "goal": 7.0}
    assert trials[0].config.env == smoke.env
    assert {trial.config.total_steps for trial in sweep.trials(48)} == {48}


@pytest.mark.parametrize(
    ("overrides", "text"),
    [
        ({"env.encoderr": "none"}, "variant 'b': TrainConfig: .*'env.encoderr'.*expected some of"),
        (
            {"envv.encoder": "none"},
            "there is no field 'envv.encoder'.*'envv' must be one of .*'env'",
        ),
        ({"env.encoder": 3}, "variant 'b': TrainConfig: env.encoder must be text, got 3"),
        ({"greedy_envs": 2}, "variant 'b': TrainConfig: greedy_envs must be in"),
    ],
)
def test_a_wrong_override_names_variant_and_field(overrides, text) -> None:
    sweep = Sweep(preset="smoke", variants=(Variant(name="b", overrides=overrides),))
    with pytest.raises(ValueError, match=text):
        sweep.trials()


def test_a_file_is_read_as_yaml_1_2_with_the_command_line_s_names(tmp_path: Path) -> None:
    file = tmp_path / "sweep.yaml"
    text = "{preset: smoke, variants: [{name: off, overrides: {tqc.actor-lr: 3e-4}}]}"
    file.write_text(text, encoding="utf-8")
    (trial,) = load_sweep(file).trials()
    assert (trial.variant.name, trial.config.tqc.actor_lr) == ("off", 3e-4)
    file.write_text(text.replace("3e-4", "2026-01-01"), encoding="utf-8")
    with pytest.raises(ValueError, match=r"tqc.actor_lr must be a number, got '2026-01-01'"):
        load_sweep(file).trials()
    file.write_text(text.replace("3e-4", "!!set {a}"), encoding="utf-8")
    place = r"variants\[0\]\.overrides\.tqc\.actor-lr"
    with pytest.raises(ValueError, match="plain data, got {'a'} for " + place):
        load_sweep(file)


def test_what_is_no_sweep_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="variants must differ, got \\['a'\\] several times"):
        Sweep(variants=(Variant(name="a"), Variant(name="a")))
    with pytest.raises(ValueError, match=r"preset must be one of .*'smoke'.*got 'smok'"):
        Sweep(preset="smok", variants=(Variant(name="a"),))
    with pytest.raises(ValueError, match="Variant: name must be letters"):
        Variant(name="a/b")
    with pytest.raises(ValueError, match=r"source must be a file .*, got 'nowhere\.yaml'"):
        load_sweep("nowhere.yaml")
    (tmp_path / "sweep.yaml").write_text("preset: smoke\nvariant: []\n")
    with pytest.raises(ValueError, match=r"sweep.yaml holds no sweep: Sweep: .*'variant"):
        load_sweep(tmp_path / "sweep.yaml")


def test_ray_s_cpus_say_how_many_run_at_a_time(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"run_sweep: jobs must be 1 with ray=True.*got 2"):
        run_sweep(load_sweep(SMOKE), tmp_path, jobs=2, ray=True)
    assert not [*tmp_path.iterdir()]


def test_a_list_of_python_s_is_a_sweep() -> None:
    sweep = load_sweep("tests.sweeps.test_sweeps:VARIANTS")
    assert [variant.name for variant in sweep.variants] == ["rays", "none"]
    assert sweep.variants[1].overrides == {"env.encoder": "none"}


def test_groups_are_chosen_beside_the_first_variant() -> None:
    sweep = Sweep(variants=tuple(Variant(name=n, group=g) for n, g in ["ax", "bx", "cy"]))
    assert [v.name for v in sweep.of_groups(["y"]).variants] == ["a", "c"]
    assert sweep.of_groups([]) == sweep
    with pytest.raises(ValueError, match=r"groups must be some of \['x', 'y'\], got \['z'\]"):
        sweep.of_groups(["z"])


@pytest.mark.slow  # five runs; resuming one is tested in tests/training
def test_a_sweep_that_was_killed_goes_on_where_it_was(tmp_path: Path) -> None:
    """Killed in its first trial; both trials end as runs of their own do."""
    command = [sys.executable, "-m", "modpush", "sweep", str(SMOKE), "--out", str(tmp_path / "s")]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    first = RunFolder(tmp_path / "s" / "attentive" / "seed_0")
    end = time.monotonic() + 600
    while first.checkpoints.latest() is None and time.monotonic() < end:
        assert process.poll() is None
        time.sleep(0.01)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    assert not (tmp_path / "s" / "uniform").exists()

    results = run_sweep(load_sweep(SMOKE), tmp_path / "s", progress=False)
    assert results["state"].tolist() == ["finished", "finished"]
    for trial in load_sweep(SMOKE).trials():
        alone = tmp_path / "alone" / trial.variant.name
        Trainer(trial.config, alone).run()
        assert_same(numbers(alone), numbers(trial.folder(tmp_path / "s").path))

    curves = pd.read_csv(tmp_path / "s" / "curves.csv")
    assert curves.groupby("variant").size().to_dict() == {"attentive": 2, "uniform": 2}
    table = pd.read_csv(tmp_path / "s" / "trials.csv")
    own = pd.read_csv(tmp_path / "alone" / "uniform" / "evaluations.csv")
    assert table["final_spl"][1] == pytest.approx(own["spl"].iloc[-1])
    assert table["best_success"][1] == own["success"].max()
    assert (tmp_path / "s" / "curves.png").stat().st_size > 10_000

    before = (tmp_path / "s" / "trials.csv").stat().st_mtime_ns
    again = run_sweep(load_sweep(SMOKE), tmp_path / "s", progress=False)
    assert again["minutes"].tolist() == results["minutes"].tolist()  # nothing ran
    assert (tmp_path / "s" / "trials.csv").stat().st_mtime_ns > before


def test_a_trial_that_fails_leaves_the_others_alone(tmp_path: Path) -> None:
    sweep = Sweep(
        preset="smoke",
        overrides={"total_steps": 48, "evaluation_episodes": 1},
        variants=(
            Variant(name="bad", overrides={"env.planner": "modpush.planners:NoSuchPlanner"}),
            Variant(name="good"),
        ),
    )
    with pytest.raises(RuntimeError, match="1 of 2 trials failed: bad/seed_0"):
        run_sweep(sweep, tmp_path, jobs=2, progress=False)
    table = pd.read_csv(tmp_path / "trials.csv")
    assert table["state"].tolist() == ["failed", "finished"]
    assert "NoSuchPlanner" in table["error"][0]

    # What is finished is not run again, and its results are written anew.
    before = (tmp_path / "trials.csv").stat().st_mtime_ns
    again = run_sweep(replace(sweep, variants=sweep.variants[1:]), tmp_path, progress=False)
    assert again["minutes"].tolist() == pytest.approx(table["minutes"].tolist()[1:])
    assert (tmp_path / "trials.csv").stat().st_mtime_ns > before
    assert (tmp_path / "curves.png").exists()


def test_a_trial_that_is_killed_has_failed(tmp_path: Path) -> None:
    trial = Sweep(preset="smoke", variants=(Variant(name="one"),)).trials()[0]
    process = start_trial(trial, tmp_path)
    process.kill()
    process.join()
    with pytest.raises(TrialFailedError, match="ended with exit status -9"):
        check_end(trial, tmp_path, process)
    assert trial_row(trial, tmp_path)["state"] == "failed"


@pytest.mark.slow  # six runs
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_runs_at_the_same_time_are_interrupted_and_end_as_those_in_turn_do(
    tmp_path: Path, number: signal.Signals
) -> None:
    sweep = replace(load_sweep(SMOKE), overrides={"total_steps": 480, "async_collection": False})
    file = tmp_path / "sweep.yaml"
    file.write_text(
        yaml.safe_dump(asdict(sweep) | {"seeds": [0], "variants": [*map(asdict, sweep.variants)]})
    )
    command = [sys.executable, "-m", "modpush", "sweep", str(file), "--jobs", "2"]
    process = subprocess.Popen([*command, "--out", str(tmp_path / "both")])
    both = [RunFolder(trial.folder(tmp_path / "both").path) for trial in sweep.trials()]
    end = time.monotonic() + 600
    while any(run.checkpoints.latest() is None for run in both) and time.monotonic() < end:
        assert process.poll() is None
        time.sleep(0.01)
    process.send_signal(number)
    assert process.wait(60) == 130
    before = [run.checkpoints.latest() for run in both]
    run_sweep(sweep, tmp_path / "both", jobs=2, progress=False)
    assert before != [run.checkpoints.latest() for run in both]
    run_sweep(sweep, tmp_path / "in_turn", progress=False)
    for trial in sweep.trials():
        paths = (trial.folder(tmp_path / name).path for name in ("in_turn", "both"))
        assert_same(*map(numbers, paths))


@pytest.mark.slow
@pytest.mark.ray
def test_trials_of_ray_end_as_those_in_turn_do(tmp_path: Path) -> None:
    pytest.importorskip("ray")
    run_sweep(load_sweep(SMOKE), tmp_path / "in_turn", progress=False)
    run_sweep(load_sweep(SMOKE), tmp_path / "ray", ray=True)
    for trial in load_sweep(SMOKE).trials():
        paths = (trial.folder(tmp_path / name).path for name in ("in_turn", "ray"))
        assert_same(*map(numbers, paths))


def test_the_ablations_are_as_many_runs_as_their_file_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    trials = load_sweep(ROOT / "examples" / "sweeps" / "ablations.yaml").trials()
    assert len(trials) == 3 * 39
    assert {trial.config.total_steps for trial in trials} == {100_000}
    configs = [trial.config for trial in trials if trial.seed == 0]
    assert len({repr(config) for config in configs}) == len(configs)  # no variant changes nothing


def test_the_latent_sizes_are_compared_with_the_baseline_of_the_ablations(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    folder = ROOT / "examples" / "sweeps"
    ablations, sizes = (
        load_sweep(folder / f"{name}.yaml") for name in ("ablations", "latent_sizes")
    )
    with pytest.raises(
        ValueError, match=r"variant 'latent_8': env.encoder must be an existing file"
    ):
        sizes.trials()
    for size in (8, 16, 64):
        file = Path(f"runs/vae_{size}/depth_vae.safetensors")  # as train_vae.py names it
        file.parent.mkdir(parents=True)
        file.touch()
    trials = sizes.trials()
    assert trials[0].config == ablations.trials()[0].config
    assert len({repr(trial.config) for trial in trials}) == 3 * 4
