"""Compiled kernels are kept on disk; whatever goes wrong there costs time and never the result."""

import errno
import importlib.util
import re
import sys
from pathlib import Path

import pytest
from numba.core import caching

import modpush
from modpush import _kernels

HELPER = """
from modpush._kernels import njit

@njit()
def helper(x):
    return x + {added}
"""
KERNEL = """
from modpush._kernels import njit
from kernel_helper import helper
from kernel_constant import FACTOR

@njit(nogil=True)
def kernel(x):
    return FACTOR * helper(x)
"""


@pytest.fixture
def kernel(tmp_path, monkeypatch):
    """Imports the kernel anew: `2 (x + 1)` unless told otherwise."""

    def load(added=1, factor=2):
        _kernels._origin.cache_clear()
        sources = {"helper": HELPER.format(added=added), "constant": f"FACTOR = {factor}"}
        for name, source in (*sources.items(), ("user", KERNEL)):
            path = tmp_path / f"kernel_{name}.py"
            path.write_text(source, encoding="utf-8")
            spec = importlib.util.spec_from_file_location(path.stem, path)
            module = importlib.util.module_from_spec(spec)
            monkeypatch.setitem(sys.modules, path.stem, module)
            exec(compile(source, path, "exec"), vars(module))  # not the bytecode of before
        return module.kernel

    return load


def hits(kernel):
    return sum(kernel.stats.cache_hits.values())


def kept(folder):
    return sorted((folder / "__pycache__").glob("kernel_user*.kernel"))


def no_place(*_, **__):
    raise OSError(errno.EROFS, "Read-only file system")


def test_a_kernel_is_compiled_once(kernel):
    assert (kernel()(3), hits(kernel())) == (8, 0)
    again = kernel()
    assert (again(3), hits(again)) == (8, 1)
    assert (again(3.5), hits(again)) == (9.0, 1)


def test_compiling_is_announced_once_and_loading_is_not(kernel, monkeypatch):
    told = []
    monkeypatch.setattr(_kernels.tqdm, "write", lambda text, file: told.append((text, file)))
    _kernels._announce_compiling.cache_clear()
    kernel()(3)
    kernel(added=2)(3)
    assert [file for _, file in told] == [sys.stderr]
    _kernels._announce_compiling.cache_clear()  # another process
    kernel(added=2)(3)
    assert len(told) == 1, "the kernel was on disk"


def test_kernels_beside_a_package_that_is_only_read_are_used(kernel, monkeypatch, tmp_path):
    kernel()(3)
    monkeypatch.setattr(caching.tempfile, "TemporaryFile", no_place)
    nowhere = kernel()
    assert (nowhere(3), hits(nowhere)) == (8, 1)
    monkeypatch.undo()
    monkeypatch.setattr("numba.config.CACHE_DIR", str(tmp_path / "home"))
    elsewhere = kernel()
    assert (elsewhere(3), hits(elsewhere)) == (8, 1)


@pytest.mark.parametrize(
    "damage",
    [
        lambda content: b"",
        lambda content: content[: len(content) // 2],
        lambda content: content[:-9] + bytes([content[-9] ^ 4]) + content[-8:],
        lambda content: b"\x80\x04N." * 100,
    ],
    ids=["empty", "cut off", "one bit", "another pickle"],
)
def test_a_damaged_file_is_written_again(kernel, tmp_path, damage):
    kernel()(3)
    (path,) = kept(tmp_path)
    path.write_bytes(damage(path.read_bytes()))
    damaged = kernel()
    assert (damaged(3), hits(damaged)) == (8, 0)
    mended = kernel()
    assert (mended(3), hits(mended)) == (8, 1)


@pytest.mark.parametrize("change", [{"added": 5}, {"factor": 4}])
def test_a_change_in_another_file_is_noticed(kernel, change):
    assert kernel()(3) == 8
    expected = change.get("factor", 2) * (3 + change.get("added", 1))
    assert kernel(**change)(3) == expected
    again = kernel(**change)
    assert (again(3), hits(again)) == (expected, 1)


def test_every_kernel_uses_this_cache():
    sources = [path.read_text("utf-8") for path in Path(modpush.__file__).parent.rglob("*.py")]
    assert sum("from modpush._kernels import njit" in source for source in sources) > 20
    assert not re.findall(r"\bjit\(|cache=True|from numba import .*\bn?jit", "".join(sources))
