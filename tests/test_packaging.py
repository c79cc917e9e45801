"""The files that are published: nothing is missing, and nothing is imported that is not declared."""

import email.message
import importlib.metadata
import re
import subprocess
import sys
import tarfile
import venv
import zipfile
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import modpush
from modpush._extras import EXTRAS
from tests.test_docs import python_blocks
from tools.check_release import release_notes

ROOT = Path(__file__).resolve().parents[1]
DATA = {".pyi", ".typed", ".safetensors", ".gz", ".urdf", ".md"}
"""Endings of the files beside the code that the library needs or explains itself with."""


def run(*command: str | Path, cwd: Path) -> str:
    """What a command prints; it must succeed."""
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def published(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the wheel and the source archive."""
    folder = tmp_path_factory.mktemp("dist")
    run(sys.executable, "-m", "hatchling", "build", "-d", folder, cwd=ROOT)
    return folder


@pytest.fixture(scope="module")
def wheel(published: Path) -> Path:
    return next(published.glob("*.whl"))


def dependency_closure(requirements: list[str]) -> set[str]:
    """Names of all distributions that pip would install for requirements, as they are here.

    Only those whose marker holds and that no extra asks for, unless the requirement names it.
    """
    found: set[tuple[str, str]] = set()
    waiting = [(Requirement(text), "") for text in requirements]
    while waiting:
        requirement, extra = waiting.pop()
        if requirement.marker is not None and not requirement.marker.evaluate({"extra": extra}):
            continue
        for wanted in ("", *requirement.extras):
            name = canonicalize_name(requirement.name)
            if (name, wanted) not in found:
                found.add((name, wanted))
                needs = importlib.metadata.requires(name) or []
                waiting += [(Requirement(text), wanted) for text in needs]
    return {name for name, _ in found}


def metadata(wheel: Path) -> email.message.Message:
    with zipfile.ZipFile(wheel) as archive:
        name = next(name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        return email.message_from_bytes(archive.read(name))


@pytest.fixture(scope="module")
def bare(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Python of an environment that holds the wheel and its declared dependencies, nothing else.

    The dependencies are links to those installed here, so that nothing is downloaded.
    """
    folder = tmp_path_factory.mktemp("bare")
    venv.create(folder, with_pip=False)
    site = next(folder.glob("lib/python*/site-packages"))
    for name in dependency_closure(metadata(wheel).get_all("Requires-Dist") or []):
        distribution = importlib.metadata.distribution(name)
        here = Path(str(distribution.locate_file("")))
        for top in {path.parts[0] for path in distribution.files or ()} - {"..", "__pycache__"}:
            if not (site / top).exists():
                (site / top).symlink_to(here / top)
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "install", "--quiet"]
    run(*pip, "--no-index", "--no-deps", "--target", site, wheel, cwd=folder)
    return folder / "bin" / "python"


def test_the_version_stands_in_one_place(wheel: Path) -> None:
    assert metadata(wheel)["Version"] == modpush.__version__
    assert yaml.safe_load((ROOT / "CITATION.cff").read_text())["version"] == modpush.__version__


def test_the_wheel_holds_types_weights_and_data(wheel: Path) -> None:
    packaged = set(zipfile.ZipFile(wheel).namelist())
    needed = {
        path.relative_to(ROOT).as_posix()
        for path in (ROOT / "modpush").rglob("*")
        if path.suffix in DATA or path.name == "py.typed"
    }
    assert "modpush/weights/agent_small_cube.safetensors" in needed
    assert needed <= packaged
    assert {name.split("/")[0] for name in packaged if ".dist-info" not in name} == {"modpush"}


@pytest.fixture(scope="module")
def unpacked(published: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the source archive holds."""
    folder = tmp_path_factory.mktemp("source")
    with tarfile.open(next(published.glob("*.tar.gz"))) as archive:
        archive.extractall(folder, filter="data")
    (root,) = folder.iterdir()
    return root


def test_the_wheel_that_is_built_from_the_source_archive_is_the_same(
    wheel: Path, unpacked: Path, tmp_path: Path
) -> None:
    run(sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", tmp_path, cwd=unpacked)
    with zipfile.ZipFile(tmp_path / wheel.name) as built, zipfile.ZipFile(wheel) as ours:
        assert set(built.namelist()) == set(ours.namelist())
        for name in ours.namelist():
            assert built.read(name) == ours.read(name), name


def test_every_module_imports_in_a_bare_environment(bare: Path, tmp_path: Path) -> None:
    code = """
import importlib, importlib.util, pkgutil, warnings
warnings.filterwarnings("ignore")
assert importlib.util.find_spec("pytest") is None  # it is bare
import modpush
names = [found.name for found in pkgutil.walk_packages(modpush.__path__, "modpush.")]
engine = "modpush.envs.engines.mujoco."  # nothing imports these modules before the engine is used
for name in (name for name in names if not name.startswith(engine)):
    importlib.import_module(name)
print(len(names), modpush.__file__)
"""
    count, file = run(bare, "-I", "-c", code, cwd=tmp_path).split()
    assert int(count) > 100
    assert Path(file).is_relative_to(bare.parents[1])


def test_the_command_runs_in_a_bare_environment_and_names_the_extra(
    bare: Path, tmp_path: Path
) -> None:
    assert "usage: modpush" in run(bare, "-I", "-m", "modpush", "--help", cwd=tmp_path)
    script = bare.parents[1] / "lib"
    (entry,) = script.rglob("modpush-*.dist-info/entry_points.txt")
    assert "modpush = modpush.cli.command:run_command" in entry.read_text()
    play = [bare, "-I", "-m", "modpush", "play"]
    done = subprocess.run(play, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 2, done.stdout + done.stderr
    assert "modpush play: viser not installed" in done.stderr
    assert "pip install 'modpush[view]'" in done.stderr


def test_each_extra_brings_what_its_error_promises(wheel: Path) -> None:
    declared = [Requirement(text) for text in metadata(wheel).get_all("Requires-Dist") or []]
    for package, extra in EXTRAS.items():
        brought = {
            canonicalize_name(requirement.name)
            for requirement in declared
            if requirement.marker is not None and requirement.marker.evaluate({"extra": extra})
        }
        assert canonicalize_name(package) in brought, (package, extra)


@pytest.mark.slow
def test_the_readme_runs_in_a_bare_environment(bare: Path, tmp_path: Path) -> None:
    for number, block in enumerate(python_blocks(ROOT / "README.md")):
        script = tmp_path / f"block_{number}.py"
        script.write_text(block)
        run(bare, "-I", script, cwd=tmp_path)


@pytest.mark.slow  # reads the types of torch: half a minute
def test_type_checkers_see_the_public_names(bare: Path, tmp_path: Path) -> None:
    (tmp_path / "user.py").write_text(
        "import modpush\n"
        "from modpush.agents import TQCLoss\n"
        "from modpush.planners import LazyThetaStar\n"
        "reveal_type(modpush.load_agent)\n"
        "reveal_type(modpush.PushEnv)\n"
        "reveal_type(modpush.Trainer)\n"
        "reveal_type(TQCLoss)\n"
        "reveal_type(LazyThetaStar().plan)\n"
        "modpush.no_such_name\n"
    )
    mypy = [sys.executable, "-m", "mypy", "--config-file=", "--python-executable", bare]
    options = ["--ignore-missing-imports", "--cache-dir", tmp_path / "cache"]
    done = subprocess.run(
        [*mypy, *options, "user.py"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    revealed = re.findall(r'user\.py:(\d+): note: Revealed type is "(.*)"', done.stdout)
    assert [int(line) for line, _ in revealed] == [4, 5, 6, 7, 8], done.stdout + done.stderr
    for (_, kind), result in zip(
        revealed,
        ("Agent", "PushEnv", "Trainer", "TQCLoss", "Paths"),
        strict=True,
    ):
        assert kind.startswith("def ("), kind
        assert kind.rpartition("-> ")[2].endswith(result), kind
    assert 'user.py:9: error: Module has no attribute "no_such_name"' in done.stdout


def write_release(folder: Path, changelog: str) -> Path:
    (folder / "modpush").mkdir(exist_ok=True)
    (folder / "modpush" / "__init__.py").write_text('__version__ = "1.2.3"\n')
    (folder / "CHANGELOG.md").write_text(f"# Changelog\n\n{changelog}")
    return folder


def test_a_release_has_the_notes_of_its_version(tmp_path: Path) -> None:
    changelog = (
        "## Unreleased\n\n## 1.2.3 (2030-01-31)\n\nA new thing.\n\n## 1.2.2 (2029-01-31)\n\nOld.\n"
    )
    assert release_notes("v1.2.3", write_release(tmp_path, changelog)) == "A new thing."


def test_the_changelog_can_be_released() -> None:
    text = (ROOT / "CHANGELOG.md").read_text()
    titles = re.findall(r"^## (.+)$", text, re.MULTILINE)
    assert titles[0] == "Unreleased"
    for title in titles[1:]:
        assert re.fullmatch(r"\d+\.\d+\.\d+ \(\d{4}-\d\d-\d\d\)", title), title
