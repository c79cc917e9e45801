"""Files are whole or as before, and damage is noticed."""

import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from modpush._atomic import replacing
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
from tests.damage import KINDS, noticed
from tests.full_disk import full_disk


@pytest.mark.parametrize("kind", KINDS)
def test_every_damage_is_noticed(tmp_path: Path, kind: str) -> None:
    path, read = KINDS[kind](tmp_path)
    assert noticed(path, read, flips=60, cuts=30) == (90, 90)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_200_bit_flips_and_100_truncations_are_noticed(tmp_path: Path, kind: str) -> None:
    path, read = KINDS[kind](tmp_path)
    assert noticed(path, read, flips=200, cuts=100) == (300, 300)


@pytest.mark.parametrize("kind", KINDS)
def test_a_full_disk_leaves_the_file_as_it_was(tmp_path: Path, kind: str) -> None:
    path, read = KINDS[kind](tmp_path)
    before = path.read_bytes()
    write = KINDS[kind] if kind != "run.json" else write_another
    with full_disk(10), pytest.raises(OSError, match="File too large"):
        write(tmp_path)
    assert path.read_bytes() == before
    assert not list(tmp_path.glob(".*"))
    read()


def write_another(folder: Path) -> None:
    write_json(folder / "run.json", {"a": 1}, "modpush.Results", 1)


DATA = {"a": [1, 2.5, None, "x"], "b": {"c": True}}


@pytest.mark.parametrize(
    ("write", "read", "data"),
    [
        (write_json, read_json, DATA),
        (write_yaml, read_yaml, DATA),
        (write_packed_json, read_packed_json, DATA),
        (write_packed_json, read_packed_json, [1, 2]),
    ],
)
def test_what_is_written_comes_back(tmp_path: Path, write, read, data) -> None:
    path = tmp_path / "new" / "file"
    write(path, data, "modpush.Thing", 3)
    assert read(path, "modpush.Thing", 3) == data
    with pytest.raises(ValueError, match=r"holds 'modpush.Thing', expected 'modpush.Other'"):
        read(path, "modpush.Other", 3)
    with pytest.raises(ValueError, match=r"is of version 3, expected 4"):
        read(path, "modpush.Thing", 4)
    with pytest.raises(FileNotFoundError, match=r"modpush.Thing: no file"):
        read(tmp_path, "modpush.Thing", 3)


@pytest.mark.parametrize(
    "name",
    [
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
    ],
)
def test_tensors_of_every_dtype_come_back(tmp_path: Path, name: str) -> None:
    path, dtype = tmp_path / "tensors.safetensors", getattr(torch, name)
    values = torch.arange(-6, 6)
    tensors = {
        "matrix": values.reshape(3, 4).to(dtype).T,  # not contiguous
        "scalar": torch.tensor(1).to(dtype),
        "none": torch.zeros(0, 3, dtype=dtype),
        "odd": torch.tensor([True, False, True]),
    }
    write_tensors(path, tensors, "modpush.Thing", 1, [1, {"a": None}])
    found, config = read_tensors(path, "modpush.Thing", 1)
    assert config == [1, {"a": None}]
    assert found.keys() == tensors.keys()
    for name, value in tensors.items():
        assert found[name].dtype == value.dtype
        assert torch.equal(found[name], value), name


def test_arrays_come_back_and_pickled_ones_are_not_read(tmp_path: Path) -> None:
    path = tmp_path / "arrays.npz"
    write_arrays(path, {"a": np.arange(3)}, "modpush.Thing", 1)
    np.testing.assert_array_equal(read_arrays(path, "modpush.Thing", 1)["a"], [0, 1, 2])
    np.testing.assert_array_equal(np.load(path)["a"], [0, 1, 2])  # readable by anyone


class Poison:
    """Leaves a file where it is unpickled."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self):
        return Path.touch, (self.mark,)


def test_a_poisoned_trajectory_runs_no_code(tmp_path: Path) -> None:
    path, mark = tmp_path / "poisoned.npz", tmp_path / "executed"
    array = np.empty(1, dtype=object)
    array[0] = Poison(mark)
    write_arrays(path, {"object_pose": array}, "modpush.Trajectory", 1)
    with pytest.raises(ValueError, match=r"allow_pickle=False"):
        Trajectory.load(path)
    assert not mark.exists()


@pytest.mark.parametrize("kind", KINDS)
def test_a_pickle_in_the_place_of_a_file_is_not_executed(tmp_path: Path, kind: str) -> None:
    path, read = KINDS[kind](tmp_path)
    mark = tmp_path / "executed"
    path.write_bytes(pickle.dumps(Poison(mark)))
    with pytest.raises(ValueError, match="carries no checksum"):
        read()
    torch.save({"x": Poison(mark)}, path)
    with pytest.raises(ValueError, match="carries no checksum"):
        read()
    assert not mark.exists()


def test_what_a_killed_process_left_is_removed_by_the_next_write(tmp_path: Path) -> None:
    path = tmp_path / "file.json"
    code = (
        "import os, sys; from modpush._atomic import replacing\n"
        "with replacing(sys.argv[1]) as file:\n"
        "    file.write_text('half'); os.kill(os.getpid(), 9)"
    )
    subprocess.run([sys.executable, "-c", code, str(path)], check=False)
    (leftover,) = tmp_path.glob(".*.tmp")
    other = tmp_path / leftover.name.replace("file.json", "other.json")
    other.touch()
    with replacing(path) as mine:
        assert other.exists()
        assert not leftover.exists()
        mine.write_text("{}")
    assert sorted(tmp_path.iterdir()) == sorted([path, other])
