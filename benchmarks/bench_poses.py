"""Times the planner of poses (x, y, yaw) beside SciPy's Dijkstra search on the same graph, in one run.

    python benchmarks/bench_poses.py [--maps 20] [--cpu-time]

The object is a box of 10 x 5 cm among 6 random boxes. "new map" is a whole call of `PoseField.plan`:
footprint on the map, search and path; "new goal" keeps the map; "read" keeps both. The floor is that
each pose looks at its 10 neighbours once. SciPy is given the finished graph and searches alone; its
costs are compared with ours. With `--cpu-time` it is the calling thread's own time that counts.
"""

import argparse
import time
from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray
from planner_maps import random_map
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import dijkstra

from modpush.planners import PoseField, polygon_support, warmup

clock: Callable[[], float] = time.perf_counter
SIZE = torch.tensor([0.1, 0.05])
SUPPORT = polygon_support(torch.tensor([[1, 1], [1, -1], [-1, 1], [-1, -1]]) / 2 * SIZE)[None]


def graph_of(
    cost: NDArray[np.float32], resolution: float, turn: float
) -> tuple[csr_array, NDArray[np.int64]]:
    """SciPy's graph of the poses with a finite cost, `[K, rows, columns]`, and their indices."""
    layers, rows, columns = cost.shape
    free = np.zeros((layers, rows + 2, columns + 2), dtype=bool)
    free[:, 1:-1, 1:-1] = np.isfinite(cost)
    index = np.arange(free.size).reshape(free.shape)
    edges = []
    for dr, dc in ((1, 0), (0, 1), (1, 1), (1, -1)):
        shifted = [np.roll(array, (-dr, -dc), (1, 2)) for array in (free, index)]
        joined = free & shifted[0]
        if dr and dc:  # no corner is cut
            joined &= np.roll(free, -dr, 1) & np.roll(free, -dc, 2)
        length = np.full(joined.sum(), resolution * np.hypot(dr, dc))
        edges.append((index[joined], shifted[1][joined], length))
    joined = free & np.roll(free, -1, 0)
    edges.append((index[joined], np.roll(index, -1, 0)[joined], np.full(joined.sum(), turn)))
    first, second, length = (np.concatenate(parts) for parts in zip(*edges, strict=True))
    return coo_array((length, (first, second)), shape=(free.size, free.size)).tocsr(), index


def row(name: str, times: list[float], note: str = "") -> None:
    ms = 1e3 * np.array(times)
    values = f"{np.median(ms):8.3f} | {ms.mean():8.3f} | {np.percentile(ms, 95):8.3f}"
    print(f"| {name:40} | {values} | {note} |")


def bench(resolution: float, symmetry: int, maps: int) -> None:
    field = PoseField(resolution=resolution)
    layers = field.yaws // symmetry
    rng = np.random.default_rng(0)
    times: dict[str, list[float]] = {"new map": [], "new goal": [], "read": [], "scipy": []}
    worst, poses = 0.0, 0
    for _ in range(maps):
        blocked = torch.from_numpy(random_map(rng, boxes=6, radius=0))[None]
        ends = torch.from_numpy(rng.uniform((0.3, -0.3, -3), (0.9, 0.3, 3), (3, 1, 3)))
        for name, start, goal in (
            ("new map", ends[0], ends[1]),
            ("new goal", ends[0], ends[2]),
            ("read", ends[1], ends[2]),
        ):
            begin = clock()
            field.plan(blocked, SUPPORT, start, goal, symmetry)
            times[name].append(clock() - begin)
        # A goal on the grid, which is then SciPy's source.
        place = field.positions[field.positions.shape[0] // 2, field.positions.shape[1] // 3]
        goal = torch.cat([place, torch.zeros(1)])[None]
        cost = field.cost_to_go(blocked, SUPPORT, goal, symmetry)[0].numpy()
        poses += int(np.isfinite(cost).sum()) // maps
        worst = max(worst, compare(field, cost, symmetry, times["scipy"]))
    states = layers * field.positions[..., 0].numel()
    title = f"{100 * field.resolution:.2f} cm x {layers} yaws, {states} poses, {poses} reached"
    print(f"\n### {title}\n\n| what | median ms | mean ms | p95 ms | note |\n|---|---|---|---|---|")
    move = 1e9 * np.median(times["new goal"]) / (10 * max(poses, 1))
    row("PoseField.plan, new map", times["new map"])
    row("PoseField.plan, new goal", times["new goal"], f"{move:.1f} ns a move, 10 a pose")
    row("PoseField.plan, read", times["read"])
    row("scipy dijkstra, the search alone", times["scipy"], f"costs within {worst:.1e} m")


def compare(field: PoseField, cost: NDArray, symmetry: int, times: list[float]) -> float:
    """Let SciPy search the same graph; the largest difference of the costs [m]."""
    layers = len(cost)
    turn = float(SUPPORT.max()) * 2 * np.pi / (symmetry * layers)
    graph, index = graph_of(cost, field.resolution, turn)
    source = index[:, 1:-1, 1:-1].reshape(-1)[cost.argmin()]
    begin = clock()
    found = dijkstra(graph, directed=False, indices=source)
    times.append(clock() - begin)
    reached = np.isfinite(cost)
    expected = found[index[:, 1:-1, 1:-1][reached]] + cost.min()
    return float(np.abs(expected - cost[reached]).max())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--maps", type=int, default=20)
    parser.add_argument("--cpu-time", action="store_true", help="do not count other programs")
    arguments = parser.parse_args()
    if arguments.cpu_time:
        global clock
        clock = time.thread_time
    torch.set_num_threads(1)
    warmup()
    for resolution, symmetry in ((0.018, 2), (0.02, 2), (0.01, 2), (0.01, 1)):
        bench(resolution, symmetry, arguments.maps)


if __name__ == "__main__":
    main()
