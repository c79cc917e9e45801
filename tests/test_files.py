"""Files are whole or as before, and damage of what a policy acts on is noticed."""

import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from modpush._atomic import FolderLock, FolderLockedError, replacing
from modpush.evaluation.episodes import Trajectory
from modpush.files import (
    read_arrays,
    read_json,
    read_packed_json,
    read_tensors,
    read_yaml,
    write_arrays,
    write_json,
    write_packed_json,
    write_tensors,
    write_yaml,
)
from tests.damage import KINDS, damages
from tests.full_disk import full_disk

DATA = {"a": [1, 2.5, None, "x"], "b": {"c": True}}
DTYPES = [
    "float64",
    "float32",
    "bfloat16",
    "float16",
    "int64",
    "int32",
    "int16",
    "int8",
    "uint8",
    "bool",
]


@pytest.mark.parametrize("kind", KINDS)
def test_every_damage_is_noticed(tmp_path: Path, kind: str) -> None:
    path, read = KINDS[kind](tmp_path)
    for content in damages(path.read_bytes(), 40, 20):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=path.name):
            read()


@pytest.mark.parametrize("kind", KINDS)
def test_a_full_disk_leaves_the_file_as_it_was_and_the_error_names_it(
    tmp_path: Path, kind: str
) -> None:
    path, read = KINDS[kind](tmp_path)
    before = path.read_bytes()
    with full_disk(10), pytest.raises(OSError, match=path.name):
        KINDS[kind](tmp_path)
    assert path.read_bytes() == before
    assert not list(tmp_path.glob(".*"))
    read()


def test_what_is_written_comes_back(tmp_path: Path) -> None:
    path = tmp_path / "new" / "file"
    write_json(path, DATA, "modpush.Thing", 3)
    assert read_json(path, "modpush.Thing", 3) == DATA
    for kind, version in (("modpush.Other", 3), ("modpush.Thing", 4)):
        with pytest.raises(ValueError, match=f"format '{kind} v{version}', got 'modpush.Thing v3'"):
            read_json(path, kind, version)
    write_yaml(path, DATA, "modpush.Thing", 3)
    assert read_yaml(path, "modpush.Thing") == DATA
    write_packed_json(path, [1, DATA])
    assert read_packed_json(path, "modpush.Thing") == [1, DATA]
    write_arrays(path, {"a": np.arange(3)})
    np.testing.assert_array_equal(read_arrays(path, "modpush.Thing")["a"], [0, 1, 2])
    with pytest.raises(FileNotFoundError, match="no file"):
        read_json(tmp_path, "modpush.Thing", 3)


def test_tensors_of_every_dtype_come_back(tmp_path: Path) -> None:
    path, values = tmp_path / "tensors.safetensors", torch.arange(-6, 6)
    tensors = {}
    for name in DTYPES:
        dtype = getattr(torch, name)
        tensors[f"{name} matrix"] = values.reshape(3, 4).to(dtype).T  # not contiguous
        tensors[f"{name} none"] = torch.zeros(0, 3, dtype=dtype)
    tensors["shared"] = tensors["float32 matrix"]
    write_tensors(path, tensors, "modpush.Thing", 1, [1, {"a": None}])
    found, config = read_tensors(path, "modpush.Thing", 1)
    assert config == [1, {"a": None}]
    for read in (found, load_file(path)):  # readable by anyone
        assert read.keys() == tensors.keys()
        for name, value in tensors.items():
            assert read[name].dtype == value.dtype
            assert torch.equal(read[name], value), name


class Poison:
    """Leaves a file where it is unpickled."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self):
        return Path.touch, (self.mark,)


def test_no_pickle_is_loaded(tmp_path: Path) -> None:
    mark, array = tmp_path / "executed", np.empty(1, dtype=object)
    array[0] = Poison(mark)
    write_arrays(tmp_path / "poisoned.npz", {"object_pose": array})
    with pytest.raises(ValueError, match="allow_pickle=False"):
        Trajectory.load(tmp_path / "poisoned.npz")
    for kind, make in KINDS.items():
        path, read = make(tmp_path)
        path.write_bytes(pickle.dumps(Poison(mark)))
        with pytest.raises(ValueError, match="carries no checksum"):
            read()
        torch.save({"x": Poison(mark)}, path)
        with pytest.raises(ValueError, match="carries no checksum"):
            read()
        assert not mark.exists(), kind


def test_a_killed_write_leaves_the_file_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "file.json"
    path.write_text("whole")
    code = (
        "import os, sys; from modpush._atomic import replacing\n"
        "with replacing(sys.argv[1]) as file:\n"
        "    file.write_text('half'); os.kill(os.getpid(), 9)"
    )
    subprocess.run([sys.executable, "-c", code, str(path)], check=False)
    assert path.read_text() == "whole"
    with replacing(path) as mine:
        mine.write_text("{}")
    assert [*tmp_path.iterdir()] == [path]
    assert path.read_text() == "{}"


def test_a_folder_has_one_writer_and_is_free_when_it_has_ended(tmp_path: Path) -> None:
    code = (
        "import sys, time; from modpush._atomic import FolderLock\n"
        "lock = FolderLock(sys.argv[1]); print(flush=True); time.sleep(600)"
    )
    with FolderLock(tmp_path), pytest.raises(FolderLockedError, match="in use by another process"):
        FolderLock(tmp_path)
    holder = subprocess.Popen(
        [sys.executable, "-c", code, str(tmp_path)], stdout=subprocess.PIPE, env=os.environ
    )
    assert holder.stdout is not None
    holder.stdout.readline()
    try:
        with pytest.raises(FolderLockedError, match="in use by another process"):
            FolderLock(tmp_path)
    finally:
        holder.kill()
        holder.communicate()
    FolderLock(tmp_path).release()
