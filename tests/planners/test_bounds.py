"""Compiled kernels never index out of bounds."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).with_name("kernels_under_bounds_check.py")


@pytest.mark.slow
def test_no_kernel_indexes_out_of_bounds(tmp_path):
    # In a process of its own, since numba reads the variable once; with a cache of its own, so that
    # these kernels are not kept.
    environment = {**os.environ, "NUMBA_BOUNDSCHECK": "1", "NUMBA_CACHE_DIR": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, str(SCRIPT)], capture_output=True, text=True, env=environment
    )
    assert done.returncode == 0, done.stderr
    assert "no index was out of bounds" in done.stdout
