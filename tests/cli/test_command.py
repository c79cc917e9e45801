"""The command as a whole: what it lists, what it refuses, and how it says so."""

import re
import shlex
import subprocess
import sys
from dataclasses import fields
from pathlib import Path
from types import ModuleType

import pytest

from modpush._extras import EXTRAS, MissingExtraError, require_extra
from modpush.cli import (
    SUBCOMMANDS,
    DemoConfig,
    EvaluateConfig,
    ExportConfig,
    collect,
    demo,
    evaluate,
    export,
    play,
    run_command,
)
from modpush.data import CollectConfig
from modpush.viewer import PlayConfig


def test_the_overview_lists_every_subcommand(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command([]) == 0
    printed = capsys.readouterr().out
    for name, text in SUBCOMMANDS.items():
        assert name in printed
        assert text.partition(":")[0] in " ".join(printed.split())


@pytest.mark.parametrize(
    ("module", "config"),
    [
        (demo, DemoConfig),
        (evaluate, EvaluateConfig),
        (play, PlayConfig),
        (collect, CollectConfig),
        (export, ExportConfig),
    ],
)
def test_the_help_names_every_option_and_its_default(module: ModuleType, config: type) -> None:
    texts = re.split(r"^  (?=[-A-Z])", module.__doc__ or "", flags=re.M)[1:]
    listed = {re.sub("^--(no-)?", "", re.split("[ .,]", text)[0]).lower(): text for text in texts}
    named = {"sets": "set", "formats": "format"} if module is not collect else {}
    options = {named.get(f.name, f.name.replace("_", "-")): f.default for f in fields(config)}
    assert {*listed} == {*options}
    for option, default in options.items():
        values = default if isinstance(default, tuple) else (default,)
        for value in values:
            if isinstance(value, int | float | str | Path) and not isinstance(value, bool):
                assert str(value) in listed[option], option


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (["cpuu"], r"one of cpu, .* smoke, got 'cpuu'\. Did you mean 'cpu'\?"),
        ([], r"expected a preset first, .* got nothing\."),
        (["--train.seed", "1"], r"expected a preset first, .* got '--train\.seed'\."),
    ],
)
def test_a_wrong_preset_is_refused_before_torch_is_imported(given: list[str], message: str) -> None:
    script = (
        "import sys\nfrom modpush.cli.command import run_command\n"
        f"status = run_command(['train', *{given}])\nsys.exit(status + ('torch' in sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.stderr.startswith("modpush train: expected a preset first")
    assert re.search(message, done.stderr)
    assert done.returncode == 2


def test_the_library_s_own_errors_come_without_a_traceback(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)  # the command would add it, and leave it there
    assert run_command(["evaluate", "--policy", "nobody"]) == 2
    printed = capsys.readouterr().err
    assert "modpush evaluate: policy: no 'nobody', expected agent, corridor" in printed
    assert "Traceback" not in printed


@pytest.mark.parametrize("subcommand", ["evaluate", "demo"])
def test_a_folder_that_cannot_be_made_is_named_before_anything_is_run(
    subcommand: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def refuse(*args: object, **kwargs: object) -> None:
        raise PermissionError(13, "Permission denied", "somewhere")

    monkeypatch.setattr(Path, "mkdir", refuse)
    out = tmp_path / "out"
    assert run_command([subcommand, "--policy", "scripted", "--out", str(out)]) == 2
    printed = capsys.readouterr().err
    assert f"no folder can be made (Permission denied): '{out}" in printed
    assert "Traceback" not in printed


def test_a_missing_extra_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(EXTRAS, "no_such_package", "view")
    with pytest.raises(
        MissingExtraError,
        match=r"modpush play: no_such_package not installed; .* pip install 'modpush\[view\]'",
    ):
        require_extra("modpush play", "no_such_package")
    require_extra("modpush play", "onnx")


def test_an_output_that_is_closed_early_ends_quietly() -> None:
    # Nothing is read at all, so that the first flush meets a closed pipe.
    command = f"{shlex.quote(sys.executable)} -m modpush evaluate --help | true"
    done = subprocess.run(["bash", "-o", "pipefail", "-c", command], capture_output=True, text=True)
    assert done.stderr == ""
    assert done.returncode == 141  # not 0: a run that is cut off has not ended
