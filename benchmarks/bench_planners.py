"""Times the planners, occupancy and sub-goals beside their peers, in one run.

    python benchmarks/bench_planners.py [--queries 200] [--threads 2] [--cpu-time]

Every query is timed with each planner in turn, so that a loaded machine slows all of them alike. With
`--cpu-time` it is the calling thread's own time that counts, which other programs hardly touch; the
batch on several threads is always timed by the wall clock. Peers that are not installed are left out
(they are the `bench` extra).
"""

import argparse
import importlib
import time
from collections.abc import Callable

import cv2
import numba
import numpy as np
import torch
from box_images import BAR, render, square
from planner_maps import family_maps, shortest_length, solvable_maps
from tensordict import TensorDict

from modpush.agents import PushingCorridorController
from modpush.geometry import Camera, Label
from modpush.planners import (
    AStar,
    DistanceField,
    LazyThetaStar,
    OccupancyGrid,
    OccupancyMap,
    Planner,
    PlannerSubgoals,
    inflate,
    point_along,
    warmup,
)

clock: Callable[[], float] = time.perf_counter
Query = tuple[np.ndarray, np.ndarray, np.ndarray]


def ours(planner: Planner) -> Callable[[Query], float]:
    def run(query: Query) -> float:
        occupancy, start, goal = (torch.from_numpy(part)[None] for part in query)
        return planner.plan(occupancy, start, goal).length.item()

    return run


def cell_length(path: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(np.asarray(path, float), axis=0), axis=1).sum())


def pyastar2d(query: Query) -> float:
    module = importlib.import_module("pyastar2d")
    weights = np.where(query[0], np.inf, 1.0).astype(np.float32)
    a, b = (tuple(point.astype(int)[::-1]) for point in query[1:])
    return cell_length(module.astar_path(weights, a, b, allow_diagonal=True))


def tcod(query: Query) -> float:
    module = importlib.import_module("tcod.path")
    graph = module.SimpleGraph(cost=(~query[0]).astype(np.int8), cardinal=70, diagonal=99)
    finder = module.Pathfinder(graph)
    finder.add_root(tuple(query[1].astype(int)[::-1]))
    return cell_length(finder.path_to(tuple(query[2].astype(int)[::-1])))


def available(peer: Callable[[Query], float], module: str) -> bool:
    try:
        importlib.import_module(module)
    except ImportError:
        print(f"(without {peer.__name__}: {module} is not installed)")
        return False
    return True


def row(name: str, times: list[float], note: str = "") -> None:
    ms = 1e3 * np.array(times)
    print(
        f"| {name:34} | {np.median(ms):8.3f} | {ms.mean():8.3f} | {np.percentile(ms, 95):8.3f} "
        f"| {note} |"
    )


def header(title: str, note: str) -> None:
    print(f"\n### {title}\n\n| what | median ms | mean ms | p95 ms | {note} |")
    print("|---|---|---|---|---|")


def bench_queries(queries: list[Query], title: str) -> None:
    planners: dict[str, Callable[[Query], float]] = {
        "LazyThetaStar": ours(LazyThetaStar()),
        'LazyThetaStar(nodes="grid")': ours(LazyThetaStar(nodes="grid")),
        "AStar": ours(AStar()),
        "DistanceField (field built anew)": ours(DistanceField()),
    }
    for peer, module in ((pyastar2d, "pyastar2d"), (tcod, "tcod")):
        if available(peer, module):
            planners[peer.__name__] = peer
    times: dict[str, list[float]] = {name: [] for name in planners}
    ratios: dict[str, list[float]] = {name: [] for name in planners}
    optima = [shortest_length(*query) for query in queries]
    for query, optimum in zip(queries, optima, strict=True):
        for name, run in planners.items():
            begin = clock()
            length = run(query)
            times[name].append(clock() - begin)
            ratios[name].append(length / optimum)
    header(title, "length / any-angle optimum: mean, worst")
    for name in planners:
        row(name, times[name], f"{np.mean(ratios[name]):.5f}, {np.max(ratios[name]):.5f}")


def bench_batch(queries: list[Query], threads: int) -> None:
    header("Batch of 8 scenes, LazyThetaStar, a call", "threads")
    batches = [
        [torch.from_numpy(np.stack(parts)) for parts in zip(*queries[k : k + 8], strict=True)]
        for k in range(0, len(queries) - 7, 8)
    ]
    planners = {count: LazyThetaStar() for count in (1, threads)}
    times: dict[int, list[float]] = {count: [] for count in planners}
    for _ in range(5):
        for batch in batches:
            for count, planner in planners.items():
                torch.set_num_threads(count)
                begin = time.perf_counter()
                planner.plan(*batch)
                times[count].append(time.perf_counter() - begin)
    torch.set_num_threads(1)
    for count, values in times.items():
        row("LazyThetaStar.plan, 8 scenes", values, str(count))


def bench_replanning(queries: list[Query], steps: int = 52) -> None:
    """The object moves along its path with some noise; the path is planned at every step."""
    rng = np.random.default_rng(0)
    planners = {
        "DistanceField": DistanceField(),
        "LazyThetaStar": LazyThetaStar(),
        'LazyThetaStar(nodes="grid")': LazyThetaStar(nodes="grid"),
    }
    times: dict[str, list[float]] = {name: [] for name in planners}
    worst = 0.0
    for query in queries:
        occupancy, start, goal = (torch.from_numpy(part)[None] for part in query)
        whole = LazyThetaStar().plan(occupancy, start, goal)
        for k in range(steps):
            here = point_along(whole.waypoints, whole.length * k / steps)
            here = here + torch.from_numpy(rng.uniform(-2, 2, (1, 2))).float()
            lengths = {}
            for name, planner in planners.items():
                begin = clock()
                lengths[name] = planner.plan(occupancy, here, goal).length.item()
                times[name].append(clock() - begin)
            gap = abs(lengths["DistanceField"] / max(lengths["LazyThetaStar"], 1e-9) - 1)
            worst = max(worst, gap)
    header(f"Re-planning, {len(queries)} episodes of {steps} steps, building included", "note")
    for name, values in times.items():
        note = f"lengths within {worst:.1e}" if name == "DistanceField" else ""
        row(f"{name}, a step", values, note)


def bench_occupancy() -> None:
    camera = Camera()
    bars = [(BAR, Label.OBSTACLE), ((0.8, 0.86, -0.3, 0.0, 0.06), Label.OBSTACLE)]
    images = [render([*bars[: 1 + k], (square(0.35, 0.1), Label.OBJECT)], camera) for k in range(2)]
    views = [[torch.from_numpy(part)[None] for part in image] for image in images]
    still, changing = OccupancyMap(), OccupancyMap()
    blocked = changing(views[1][0], 0.0, views[1][1])[0]
    cells = blocked[0].numpy().astype(np.uint8)
    disc = (np.hypot(*np.mgrid[-10:11, -10:11]) <= 10).astype(np.uint8)
    runs: dict[str, Callable[[int], object]] = {
        "depth -> occupancy, map still": lambda k: still(views[1][0], 0.0354, views[1][1]),
        "depth -> occupancy, map changes": lambda k: changing(
            views[k % 2][0], 0.0354, views[k % 2][1]
        ),
        "inflate by 10 px": lambda k: inflate(blocked, 10.0),
        "cv2.dilate by a 21 px disc": lambda k: cv2.dilate(cells, disc),
        "cv2.distanceTransform, precise": lambda k: (
            cv2.distanceTransform(1 - cells, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) <= 10
        ),
    }
    times: dict[str, list[float]] = {name: [] for name in runs}
    for k in range(300):
        for name, run in runs.items():
            begin = clock()
            run(k)
            times[name].append(clock() - begin)
    header("Occupancy, one 256x256 scene", "note")
    for name, values in times.items():
        row(name, values)
    bench_chain(bars, camera)


def bench_chain(bars: list, camera: Camera, scenes: int = 8) -> None:
    """Depth to sub-goal through both transforms, as an env calls them, objects moving."""
    frames = []
    for k in range(10):
        images = [
            render([*bars, (square(0.3 + 0.01 * k, 0.02 * b), Label.OBJECT)], camera)
            for b in range(scenes)
        ]
        pose = torch.tensor([[0.3 + 0.01 * k, 0.02 * b, 0.0] for b in range(scenes)])
        frames.append(
            TensorDict(
                depth=torch.from_numpy(np.stack([depth for depth, _ in images]))[:, None],
                segmentation=torch.from_numpy(np.stack([part for _, part in images]))[:, None],
                object_pose=pose,
                goal_position=torch.tensor([0.72, 0.05]).expand(scenes, 2),
                batch_size=[scenes],
            )
        )
    header(f"Depth -> sub-goal, {scenes} scenes a call, TensorDict included", "note")
    for name, planner in (
        ("DistanceField", DistanceField()),
        ("LazyThetaStar", LazyThetaStar()),
    ):
        grid, subgoals, times = OccupancyGrid(), PlannerSubgoals(planner), []
        first = frames[0].clone()
        before = subgoals._reset(first.empty(), grid._reset(first.empty(), first))
        for k in range(300):
            now = frames[k % 10].clone()
            begin = clock()
            now = subgoals._step(before, grid._step(before, now))
            times.append(clock() - begin)
            before = now
        row(f"occupancy and {name}", times[10:])
    controller, times = PushingCorridorController(), []
    state = controller(with_tool(frames[0]))["next", "corridor"]
    for k in range(300):
        now = with_tool(frames[k % 10]).set("corridor", state)
        begin = clock()
        state = controller(now)["next", "corridor"]
        times.append(clock() - begin)
    row("PushingCorridorController, to the action", times[10:])


def with_tool(frame: TensorDict) -> TensorDict:
    """The tool stands 8 cm behind the object, and a little aside."""
    return frame.clone().set("ee_pose", frame["object_pose"] - torch.tensor([0.08, 0.02, 0.0]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--queries", type=int, default=200)
    parser.add_argument("--threads", type=int, default=numba.config.NUMBA_NUM_THREADS)
    parser.add_argument("--cpu-time", action="store_true", help="do not count other programs")
    arguments = parser.parse_args()
    if arguments.queries < 8:
        parser.error(f"--queries must be >= 8, one batch, got {arguments.queries}.")
    if arguments.cpu_time:
        global clock
        clock = time.thread_time
    torch.set_num_threads(1)
    warmup()
    queries = list(solvable_maps(0, arguments.queries))
    for run in (ours(AStar()), pyastar2d):  # load what loads at first use
        if run is not pyastar2d or available(pyastar2d, "pyastar2d"):
            run(queries[0])
    bench_queries(queries, f"{len(queries)} random maps, 10 boxes")
    families = list(family_maps(1, arguments.queries))
    bench_queries(families, f"{len(families)} maps of the families")
    bench_batch(queries, arguments.threads)
    bench_replanning(queries[:40])
    bench_occupancy()


if __name__ == "__main__":
    main()
