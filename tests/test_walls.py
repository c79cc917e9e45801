"""Who may know whom (docs/architecture.md)."""

import ast
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

import modpush

ROOT = Path(modpush.__file__).parent
ROOMS = ("planners", "encoders", "agents", "replay", "evaluation", "envs")
MAY_KNOW = {
    "planners": {"planners"},
    "encoders": {"encoders", "planners"},
    "agents": {"agents", "planners"},
    "replay": {"replay"},
    "envs": {"envs"},
    "evaluation": {"envs", "evaluation", "planners"},
}
PLAIN_DATA = {"drawing", "objects", "scenarios", "scenes"}
SIMULATOR = {"sapien", "mani_skill"}
KNOW_THE_SIMULATOR = {
    "robot",
    "task",
    "depth",
    "batch",
    "bodies",
    "building",
    "obstacles",
    "camera",
    "contacts",
    "cpu_scene",
}


def imports_of(path: Path) -> set[str]:
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names.add(node.module)
    return names


@pytest.mark.parametrize("room", sorted(MAY_KNOW))
def test_a_room_imports_only_the_rooms_it_may(room: str) -> None:
    known = set()
    for path in (ROOT / room).rglob("*.py"):
        for name in imports_of(path):
            if name.startswith("modpush."):
                known.add(name.split(".")[1])
    assert known <= MAY_KNOW[room]


def test_evaluation_knows_the_plain_data_of_envs_only() -> None:
    known = {
        name.removeprefix("modpush.envs").removeprefix(".")
        for path in (ROOT / "evaluation").rglob("*.py")
        for name in imports_of(path)
        if name.startswith("modpush.envs")
    }
    assert known <= PLAIN_DATA
    assert not known & KNOW_THE_SIMULATOR


def test_only_some_files_of_envs_know_the_simulator() -> None:
    knowing = {
        path.stem
        for path in (ROOT / "envs").glob("*.py")
        if any(name.split(".")[0] in SIMULATOR for name in imports_of(path))
    }
    assert knowing <= KNOW_THE_SIMULATOR


@pytest.mark.parametrize("room", ROOMS)
def test_importing_a_room_loads_no_simulator(room: str) -> None:
    code = (
        f"import sys, modpush.{room} as room; [getattr(room, n) for n in getattr(room, '__all__', [])"
        f" if {room!r} != 'envs']; print(sorted({SIMULATOR} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("room", ROOMS)
def test_every_public_name_resolves(room: str) -> None:
    module = importlib.import_module(f"modpush.{room}")
    for name in getattr(module, "__all__", []):
        assert getattr(module, name) is not None


def test_opencv_works_beside_the_copy_that_sapien_asks_for() -> None:
    import cv2
    import numpy as np

    assert cv2.connectedComponents(np.ones((2, 2), np.uint8))[0] == 2
