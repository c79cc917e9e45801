"""What all tests share."""

import gc
import os
from collections.abc import Iterator
from typing import Any

import pytest
import torch


def pytest_configure() -> None:
    # Small tensors only: a second thread costs more than it brings, and CI has two cores for all.
    torch.set_num_threads(1)
    os.environ["OMP_NUM_THREADS"] = "1"  # likewise in the processes that tests start


def pytest_collection_finish() -> None:
    freeze()


@pytest.fixture(scope="module", autouse=True)
def _freeze_after_module() -> Iterator[None]:
    yield
    freeze()  # what the module imported, such as ManiSkill


def freeze() -> None:
    """Leave what is alive now out of later garbage collections.

    An environment that is closed collects garbage. To look at all modules costs 0.4 s each time.
    """
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session")
def render_device() -> str:
    from modpush.envs.engines.sapien.rendering import NO_RENDERER, find_render_device

    device = find_render_device()
    if device is None:
        pytest.skip(NO_RENDERER)
    return device


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """A Ray cluster of two nodes with a CPU each, to which this process is connected."""
    ray = pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    cluster = Cluster(
        initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False}
    )
    cluster.add_node(num_cpus=1)
    ray.init(address=cluster.address, log_to_driver=False)
    yield cluster
    ray.shutdown()
    cluster.shutdown()
