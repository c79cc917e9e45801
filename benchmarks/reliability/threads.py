"""Four threads plan with one planner, and each answer is compared with that of a thread alone.

    python benchmarks/reliability/threads.py                  # 4 x 10,000 plans of each planner
    python benchmarks/reliability/threads.py --plans 500      # half a minute

Threads take the same maps of 64 x 64 cells in different orders, each with batches of another size, so
that a workspace that two of them shared would hold another map. Compared are all fields of `Paths`, to
the last bit. `OccupancyMap`, which has workspaces of its own, is hammered the same way.
"""

import itertools
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier

import numpy as np
import torch
import tyro

from modpush.geometry import Camera
from modpush.planners import PLANNERS, OccupancyMap, make_planner

THREADS = 4
SIDE = 64
BATCHES = (1, 3, 7, 16)
"""Sizes of the batches of the first, second, third and fourth thread."""
ROUNDS = 25
"""Number of different batches of each thread."""

Call = Callable[..., Sequence[torch.Tensor]]
Inputs = tuple[torch.Tensor, ...]


def queries(batch: int, rng: np.random.Generator) -> Inputs:
    """Maps with a quarter of their blocks of 4 x 4 cells occupied, starts and goals anywhere."""
    blocks = torch.from_numpy(rng.random((batch, SIDE // 4, SIDE // 4)) < 0.25)
    occupancy = blocks.repeat_interleave(4, 1).repeat_interleave(4, 2)
    start, goal = torch.from_numpy(rng.uniform(-1, SIDE, (2, batch, 2)).astype(np.float32))
    return occupancy, start, goal


def images(batch: int, rng: np.random.Generator) -> Inputs:
    """Depth images of obstacles 6 cm high, and inflations."""
    camera = Camera(height=SIDE, width=SIDE)
    depth = torch.full((batch, SIDE, SIDE), camera.z)
    depth[queries(batch, rng)[0]] -= 0.06
    return depth, torch.from_numpy(rng.uniform(0, 0.05, batch).astype(np.float32))


def hammer(call: Call, inputs: list[list[Inputs]], plans: int) -> tuple[int, int]:
    """How many plans the threads made in all, and how many of them differ from those made alone."""
    expected = [[call(*given) for given in own] for own in inputs]
    barrier = Barrier(THREADS)

    def work(thread: int) -> tuple[int, int]:
        made = different = 0
        own, true = inputs[thread], expected[thread]
        order = itertools.cycle(np.random.default_rng(thread).permutation(len(own)))
        barrier.wait()
        while made < plans:
            k = next(order)
            got = call(*own[k])
            wrong = torch.zeros(len(own[k][0]), dtype=torch.bool)
            for one, other in zip(got, true[k], strict=True):
                if one.shape != other.shape:  # other numbers of waypoints
                    wrong[:] = True
                    continue
                # The fields' first dimension is the batch; not-a-number marks a path that is not there.
                same = (one == other) | ((one != one) & (other != other))
                wrong |= ~same.flatten(1).all(1) if same.ndim > 1 else ~same
            made += len(wrong)
            different += int(wrong.sum())
        return made, different

    with ThreadPoolExecutor(THREADS) as pool:
        counts = list(pool.map(work, range(THREADS)))
    return sum(made for made, _ in counts), sum(different for _, different in counts)


def main(plans: int = 10_000, seed: int = 0) -> None:
    """Print the table.

    Args:
        plans: Number of plans of each thread.
        seed: Seed of the maps.
    """
    torch.set_num_threads(1)
    sys.setswitchinterval(1e-4)  # threads take turns often, so that what can meet does
    print("| object | threads | plans | different | seconds |\n|---|---|---|---|---|")
    for name in [*PLANNERS, "OccupancyMap"]:
        rng = np.random.default_rng(seed)
        if name == "OccupancyMap":
            call: Call = OccupancyMap(Camera(height=SIDE, width=SIDE))
            draw: Callable[[int, np.random.Generator], Inputs] = images
        else:
            planner, draw = make_planner(name), queries

            def call(*given: torch.Tensor, planner=planner) -> Sequence[torch.Tensor]:
                return tuple(vars(planner.plan(*given)).values())

        inputs = [[draw(batch, rng) for _ in range(ROUNDS)] for batch in BATCHES]
        start = time.monotonic()
        made, different = hammer(call, inputs, plans)
        print(f"| {name} | {THREADS} | {made} | {different} | {time.monotonic() - start:.0f} |")


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
