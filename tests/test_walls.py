"""Which package may import which (docs/decisions.md)."""

import ast
import importlib
import pkgutil
import subprocess
import sys
from pathlib import Path

import pytest

import modpush

ROOT = Path(modpush.__file__).parent
SHARED = {
    "_arguments",
    "_atomic",
    "_batching",
    "_checks",
    "_extras",
    "_kernels",
    "_keys",
    "_precision",
    "_processes",
    "_state",
    "_transforms",
    "_types",
    "_validation",
    "_yaml",
    "files",
    "parts",
}
_STACK = {"geometry", "envs", "planners", "encoders", "mdp", "agents", "replay"}
MAY_KNOW = {
    "geometry": set(),
    "envs": {"geometry"},
    "planners": {"geometry"},
    "encoders": {"geometry"},
    "mdp": {"geometry", "envs.scenes", "envs.outcome"},
    "agents": {"geometry", "planners"},
    "replay": set(),
    "recipes": _STACK,
    "evaluation": {"geometry", "envs.scenes", "planners"},
    "training": _STACK | {"recipes", "evaluation"},
    "export": {"geometry", "envs.robot", "encoders", "mdp", "agents", "planners", "recipes"},
    "data": {"geometry", "envs", "mdp", "recipes", "evaluation"},
    "deploy": _STACK - {"replay"} | {"recipes", "export"},
    "viewer": _STACK - {"replay"} | {"recipes", "evaluation", "training"},
    "cli": _STACK | {"recipes", "evaluation", "training", "export", "data", "deploy", "viewer"},
}
"""What each package may import besides itself and the shared modules."""
SIMULATOR = {"sapien", "mani_skill", "mujoco"}
WITHOUT_SIMULATOR = sorted(
    set(MAY_KNOW) - {"recipes", "training", "export", "data", "deploy", "cli"}
)


def imported_modules(source: str, package: str) -> set[str]:
    """Dotted names of all that a source file imports, whatever the form of the import.

    `from a import b` counts as both `a` and `a.b`, since `b` may be a module.

    Args:
        source: Python source.
        package: The package that the file is in, `"modpush.envs"`.
    """
    names: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            parts = package.split(".")
            base = ".".join(parts[: len(parts) - node.level + 1]) if node.level else ""
            module = ".".join(part for part in (base, node.module) if part)
            names |= {module} | {f"{module}.{alias.name}" for alias in node.names}
    return names


def imports_of_package(package: str) -> dict[Path, set[str]]:
    found = {}
    for path in sorted((ROOT / package).rglob("*.py")):
        inside = path.relative_to(ROOT.parent).parent.parts
        found[path] = imported_modules(path.read_text(), ".".join(inside))
    return found


def refused(names: set[str], package: str) -> set[str]:
    """Names of modpush's modules among those that the package may not import."""
    allowed = MAY_KNOW[package] | SHARED | {package}
    inside = {name.removeprefix("modpush.") for name in names if name.startswith("modpush.")}
    return {
        name
        for name in inside
        if not any(
            # `from modpush.envs import scenes` names the parent package as well.
            name == a or name.startswith(f"{a}.") or a.startswith(f"{name}.")
            for a in allowed
        )
    }


@pytest.mark.parametrize("package", sorted(MAY_KNOW))
def test_a_package_imports_only_those_it_may(package: str) -> None:
    wrong = {
        str(path.relative_to(ROOT)): bad
        for path, names in imports_of_package(package).items()
        if (bad := refused(names, package))
    }
    assert not wrong


def test_every_package_is_checked() -> None:
    packages = {path.parent.name for path in ROOT.glob("*/__init__.py")}
    assert packages == set(MAY_KNOW)


def test_only_an_engine_s_own_folder_imports_its_simulator() -> None:
    for path, names in imports_of_package("envs").items():
        own = path.relative_to(ROOT / "envs").as_posix()
        known = {"mujoco"} if own.startswith("engines/mujoco/") else set()
        known |= {"sapien", "mani_skill"} if own.startswith("engines/sapien/") else set()
        assert {name.split(".")[0] for name in names} & SIMULATOR <= known, path
    for package in set(MAY_KNOW) - {"envs"}:
        for path, names in imports_of_package(package).items():
            assert not {name.split(".")[0] for name in names} & SIMULATOR, path


def test_importing_a_package_loads_no_simulator() -> None:
    # In one process for all: the first package after which the simulator is there has loaded it.
    # TorchRL imports MuJoCo wherever it is installed, so that the engine's own package stands for it.
    simulators = SIMULATOR - {"mujoco"} | {"modpush.envs.engines.mujoco"}
    code = (
        "import importlib, sys\n"
        f"for name in {WITHOUT_SIMULATOR}:\n"
        "    package = importlib.import_module(f'modpush.{name}')\n"
        "    [getattr(package, public) for public in package.__all__ if name != 'envs']\n"
        f"    assert not {simulators} & set(sys.modules), name"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("package", ["", *sorted(MAY_KNOW)])
def test_every_public_name_resolves_and_is_listed(package: str) -> None:
    module = importlib.import_module(f"modpush.{package}".rstrip("."))
    assert module.__all__
    for name in module.__all__:
        assert getattr(module, name) is not None
        assert name in dir(module)


@pytest.mark.parametrize("package", ["", *sorted(MAY_KNOW)])
def test_no_public_name_is_a_module_s_too(package: str) -> None:
    """Importing `package.name` would put the module where the name is looked up."""
    module = importlib.import_module(f"modpush.{package}".rstrip("."))
    modules = {found.name for found in pkgutil.iter_modules(module.__path__)}
    assert not modules & set(module.__all__)


def test_neither_the_import_nor_a_help_text_loads_anything_heavy() -> None:
    # In one process for all: each part loads more than the one before.
    code = (
        "import sys\n"
        "def check(part, *heavy):\n"
        "    assert not {*heavy} & {*sys.modules}, (part, {*heavy} & {*sys.modules})\n"
        "import modpush\n"
        "check('modpush', 'torch', 'numba', 'cv2')\n"
        "from modpush.cli.command import run_command\n"
        "run_command(['--help'])\n"
        "check('--help', 'torch', 'numpy', 'numba', 'cv2', 'tyro', 'gymnasium')\n"
        "for subcommand in ('train', 'evaluate', 'collect'):\n"
        "    try:\n"
        "        run_command([subcommand, '--help'])\n"
        "    except SystemExit:\n"
        "        pass\n"
        "    check(subcommand, 'torch', 'pandas', 'numba', 'cv2', 'gymnasium')\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_opencv_works_beside_the_copy_that_sapien_asks_for() -> None:
    import cv2
    import numpy as np

    assert cv2.connectedComponents(np.ones((2, 2), np.uint8))[0] == 2
