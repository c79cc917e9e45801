"""What all tests share."""

import os

import pytest
import torch


def pytest_configure() -> None:
    # Small tensors only: a second thread costs more than it brings, and CI has two cores for all.
    torch.set_num_threads(1)
    os.environ["OMP_NUM_THREADS"] = "1"  # likewise in the processes that tests start


@pytest.fixture(scope="session")
def render_device() -> str:
    from modpush.envs.sim.rendering import NO_RENDERER, find_render_device

    device = find_render_device()
    if device is None:
        pytest.skip(NO_RENDERER)
    return device
