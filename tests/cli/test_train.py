"""`modpush train` runs a preset with changed options."""

import dataclasses
import re
import shlex
from dataclasses import replace

import pytest
import torch
import yaml

from modpush.cli import RunConfig, run_command, train
from modpush.encoders import ENCODERS
from modpush.planners import PLANNERS
from modpush.training import TRAIN_PRESETS, Trainer
from modpush.training.run_folder import RunFolder

TERM = """
def large_actions(outcome):
    return -outcome["action"].square().sum(-1, keepdim=True)
"""


def test_a_run_from_the_command_line(tmp_path, monkeypatch, capsys) -> None:
    command = ["train", "smoke", "--out", "run", "--train.total-steps", "96", "--train.seed", "3"]
    command += ["--reward-term", "calm:large_actions", "0.2"]
    (tmp_path / "calm.py").write_text(TERM)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    assert run_command(command) == 0
    assert "Best on the held-out episodes: success" in capsys.readouterr().out
    folder = tmp_path / "run"
    config = yaml.safe_load((folder / "config.yaml").read_text())
    assert config["seed"] == 3
    assert config["env"]["reward"]["weights"]["calm:large_actions"] == 0.2
    assert (folder / "best_agent.safetensors").is_file()
    assert (folder / "curve.png").is_file()


def test_a_run_trains_on_as_many_threads_as_asked_for(tmp_path, monkeypatch) -> None:
    # Only asked, not trained: the kernels' form for several threads takes half a minute to compile.
    seen = set()
    monkeypatch.setattr(Trainer, "_run", lambda trainer: seen.add(torch.get_num_threads()))
    train.main(["smoke", "--out", str(tmp_path / "run"), "--threads", "2"])
    assert seen == {2}
    assert torch.get_num_threads() == 1


def test_the_help_names_every_preset_and_only_options_that_exist() -> None:
    text = train.__doc__
    assert len(text.splitlines()) < 120
    presets = text.partition("Presets:\n")[2].partition("\n\n")[0]
    assert re.findall(r"^  (\w+)", presets, re.MULTILINE) == [*TRAIN_PRESETS]
    options = text.partition("\nRun:\n")[2]
    config = TRAIN_PRESETS["cpu"]
    there = {
        "--config",
        "--allow",
        *train.SHORT_FORMS,
        *(f"--{name}" for name in option_names(RunConfig(train=config))),
    }
    named = {re.sub("[.]TERM$", ".goal", name) for name in re.findall(r"--[a-z][\w.-]*\w", options)}
    assert {name.replace("--train.no-", "--train.") for name in named} - {"--train"} <= there
    assert len(named) > 40
    words = set(re.findall(r"\w+", text))
    assert words >= {*PLANNERS}
    assert words >= {*ENCODERS} - {"conv"}


def test_the_help_shows_the_defaults_of_cpu() -> None:
    config = RunConfig(train=TRAIN_PRESETS["cpu"])
    options = re.split(r"^  --", train.__doc__, flags=re.M)[1:]
    shown = {
        text.split()[0]: match[1] for text in options if (match := re.search(r"\[(.+)\]\.", text))
    }
    assert len(shown) > 25
    for name, default in shown.items():
        value = config
        long = train.SHORT_FORMS.get(f"--{name}", f"--{name}").removeprefix("--")
        for part in long.replace("-", "_").split("."):
            value = getattr(value, part)
        values = value if isinstance(value, tuple) else (value,)
        texts = [f"{v:.3g}" if isinstance(v, float) else str(v) for v in values]
        assert default == " ".join(texts), name


def option_names(config: object) -> set[str]:
    """Options of a configuration without the dashes in front."""
    names = set()
    for name, value in vars(config).items():
        if dataclasses.is_dataclass(value):
            names |= {f"{name}.{inner}" for inner in option_names(value)}
        if isinstance(value, dict):
            names |= {f"{name}.{key}" for key in value}
        names.add(name)
    return {name.replace("_", "-") for name in names}


def test_the_examples_of_the_help_are_understood(tmp_path, monkeypatch) -> None:
    runs = []
    monkeypatch.setattr(train, "train_agent", runs.append)
    examples = re.findall(r"^    modpush (train .*?)(?:  +#.*)?$", train.__doc__, re.M)
    for example in examples:
        assert run_command(shlex.split(example)) == 0
    assert len(runs) == len(examples) > 5
    assert runs[1].resume
    assert runs[4].train.env.encoder == "rays"


def test_settings_of_a_file_replace_the_presets_and_options_those_of_the_file(tmp_path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(
        "seed: 3\ntotal_steps: 5_000\nenv: {encoder: rays, reward: {weights: {goal: 2}}}\n"
    )
    run = train.parse_run(["cpu", "--config", str(file), "--train.seed", "4"])
    cpu = TRAIN_PRESETS["cpu"]
    reward = replace(cpu.env.reward, weights={"goal": 2.0})
    env = replace(cpu.env, encoder="rays", reward=reward)
    assert run.train == replace(cpu, seed=4, total_steps=5_000, env=env)


def test_the_config_of_a_run_repeats_it_whatever_the_preset(tmp_path) -> None:
    for name, config in TRAIN_PRESETS.items():
        folder = RunFolder(tmp_path / name)
        folder.write_config(config)
        run = train.parse_run(["any_object", "--config", str(folder.config)])
        assert run.train == config


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("tqc: {gama: 0.9}", "gama"),
        ("tqc: {gamma: often}", "gamma: Input should be a valid number"),
        ("- 3", "expected fields of TrainConfig by name"),
        ("env: {planner: 'my_lab:Planner'}", "--allow my_lab"),
        ("env: {", "damaged or of another structure"),
        (None, "no file"),
    ],
)
def test_a_file_of_settings_that_does_not_fit_is_named(tmp_path, capsys, content, message) -> None:
    file = tmp_path / "mine.yaml"
    if content is not None:
        file.write_text(content)
    assert run_command(["train", "cpu", "--config", str(file)]) == 2
    printed = capsys.readouterr().err
    assert message in printed
    assert str(file) in printed
