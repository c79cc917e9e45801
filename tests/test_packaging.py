"""The files that are published: nothing is missing, and nothing is imported that is not declared."""

import email.message
import importlib.metadata
import subprocess
import sys
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
    distributions = {
        "rtde_control": "ur_rtde",
        "rtde_receive": "ur_rtde",
    }  # else named as the package
    for package, extra in EXTRAS.items():
        brought = {
            canonicalize_name(requirement.name)
            for requirement in declared
            if requirement.marker is not None and requirement.marker.evaluate({"extra": extra})
        }
        name = canonicalize_name(distributions.get(package, package))
        assert name in brought, (package, extra)


@pytest.mark.slow
def test_the_readme_runs_in_a_bare_environment(bare: Path, tmp_path: Path) -> None:
    for number, block in enumerate(python_blocks(ROOT / "README.md")):
        script = tmp_path / f"block_{number}.py"
        script.write_text(block)
        run(bare, "-I", script, cwd=tmp_path)
