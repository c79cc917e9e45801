"""One planner or map, shared by several threads."""

from concurrent.futures import ThreadPoolExecutor
from threading import Barrier

import numpy as np
import pytest
import torch

from modpush.geometry import Camera
from tests.planners.test_planner import MAKERS, QUICK_ON_THREADS

BATCHES = (1, 7, 30, 64)
SMALL = Camera(height=48, width=48)


CASES = [
    pytest.param(
        threads,
        make,
        id=f"{threads}-{name}",
        marks=[] if threads == 1 or name in QUICK_ON_THREADS else pytest.mark.slow,
    )
    for threads in (1, 2)
    for name, make in MAKERS.items()
]
every_planner = pytest.mark.parametrize(
    ("torch_threads", "make"), CASES, indirect=["torch_threads"]
)


@pytest.fixture(params=[1, pytest.param(2, marks=pytest.mark.slow)])
def torch_threads(request):
    torch.set_num_threads(request.param)
    yield
    torch.set_num_threads(1)


def some_queries(batch):
    rng = np.random.default_rng(batch)
    occupancy = torch.from_numpy(rng.random((batch, 12, 12)) < 0.25)
    occupancy = occupancy.repeat_interleave(4, 1).repeat_interleave(4, 2)
    start, goal = torch.from_numpy(rng.uniform(-1, 48, (2, batch, 2)).astype(np.float32))
    return occupancy, start, goal


def assert_threads_get_the_same(call, inputs, rounds=25):
    """Four threads, each beginning with another of the inputs, get what one thread got."""
    expected = [call(*given) for given in inputs]
    barrier = Barrier(len(inputs))

    def work(first):
        barrier.wait()
        for k in range(rounds):
            which = (first + k) % len(inputs)
            results = call(*inputs[which])
            for got, true in zip(results, expected[which], strict=True):
                assert torch.equal(got, true)

    with ThreadPoolExecutor(len(inputs)) as pool:
        list(pool.map(work, range(len(inputs))))


@every_planner
def test_a_planner_shared_by_threads_plans_as_on_one(torch_threads, make):
    planner = make()

    def call(*query):
        return tuple(vars(planner.plan(*query)).values())

    assert_threads_get_the_same(call, [some_queries(batch) for batch in BATCHES])


@every_planner
def test_threads_with_batches_of_one_size_do_not_interfere(torch_threads, make):
    planner = make()

    def call(*query):
        return tuple(vars(planner.plan(*query)).values())

    occupancy, start, goal = some_queries(28)
    assert_threads_get_the_same(
        call, [(occupancy[k::4], start[k::4], goal[k::4]) for k in range(4)], rounds=50
    )
