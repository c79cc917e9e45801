"""Run by `test_bounds.py` in a process with NUMBA_BOUNDSCHECK=1: every kernel, on all kinds of input."""

import math

import torch

from modpush.encoders import egocentric_window
from modpush.geometry import Camera
from modpush.planners import PLANNERS, AStar, OccupancyMap, PoseField, inflate

SHAPES = [(1, 1), (1, 9), (9, 1), (7, 65), (40, 64)]
FAR = 3e38


def grids(height: int, width: int) -> list[torch.Tensor]:
    """Free, blocked, noisy, and with one free cell, `[3, H, W]` each."""
    noise = torch.rand(3, height, width)
    one_free = torch.ones(3, height, width, dtype=torch.bool)
    one_free[:, -1, -1] = False
    free = torch.zeros_like(one_free)
    return [free, ~free, one_free, noise < 0.2, noise < 0.6]


def ends(height: int, width: int) -> list[torch.Tensor]:
    """Points inside, on the rim, on cells' corners, and far outside, `[3, 2]` each."""
    size = torch.tensor([width, height]).float()
    return [
        torch.rand(3, 2) * size,
        torch.stack([torch.full((2,), -0.5), size - 0.5, size / 2]),
        torch.tensor([[-FAR, FAR], [FAR, 0.0], [-1.0, -7.0]]),
    ]


def plan_everywhere() -> None:
    """All planners, one scene and several, known maps and new ones."""
    planners = {name: make() for name, make in PLANNERS.items()}
    for shape in SHAPES:
        for grid in grids(*shape):
            for start in ends(*shape):
                for goal in ends(*shape):
                    for planner in planners.values():
                        planner.plan(grid, start, goal)
                        planner.plan(grid[:1], start[:1], goal[:1])
            weight = torch.rand(grid.shape) + 0.1
            AStar(neighbours=4).plan_weighted(grid, weight, start, goal)
            inflate(grid, torch.tensor([0.0, 2.5, 1e30]))
    noise = torch.rand(2, 128, 128) < 0.25  # more corners than are searched
    start, goal = torch.zeros(2, 2), torch.full((2, 2), 127.0)
    comb = torch.zeros(2, 21, 161, dtype=torch.bool)  # more waypoints than there is room for
    for k in range(40):
        comb[:, slice(0, 20) if k % 2 else slice(1, 21), 4 * k + 2] = True
    for planner in planners.values():
        planner.plan(noise, start, goal)
        planner.plan(comb, torch.tensor([[0.0, 10.0]] * 2), torch.tensor([[160.0, 10.0]] * 2))


def look_everywhere() -> None:
    """Occupancy and windows of depth images with all that a depth camera may say."""
    for height, width in [(1, 1), (5, 70), (64, 48)]:
        camera = Camera(height=height, width=width)
        depth = camera.z - 0.08 * torch.rand(2, height, width)
        odd = depth.flatten(1)
        strange = torch.tensor([0.0, -1.0, math.nan, math.inf, 1e-30])[: odd.shape[1]]
        odd[:, : len(strange)] = strange
        labels = torch.randint(0, 4, (2, height, width), dtype=torch.uint8)
        position = torch.tensor([[0.6, 0.0], [1e30, -1e30]])
        for upright in (True, False):
            seen = OccupancyMap(camera, upright=upright)
            _, bits = seen(depth, 0.03, labels)
            seen(depth, 1e9, labels, previous=bits)
            seen(depth[:1], 0.0, None, position[:1])
            seen(depth, 0.05, None, position)
            for size in (1, 16):
                for x in (0.6, 0.9, -1e6, 1e300):
                    pose = torch.tensor([[x, 0.1, 0.4], [0.6, x, -1e5]], dtype=torch.float64)
                    options = {"size": size, "upright": upright, "camera": camera}
                    options["metres_per_pixel"] = camera.cell_size
                    egocentric_window(depth, labels, pose, **options)
                    egocentric_window(depth, None, pose, outside="blocked", **options)
    many = torch.full((64, 8, 8), 1.05)
    egocentric_window(many, None, torch.rand(64, 3), size=8)


def plan_poses_everywhere() -> None:
    """Pose fields on grids of all sizes, of footprints larger than the image and smaller than a pixel."""
    for height, width in SHAPES:
        camera = Camera(height=height, width=width)
        extent = camera.cell_size * torch.tensor([[0.3], [3.0], [500.0]]).expand(3, 5)
        for resolution in (1e-6, 3.0 * camera.cell_size, 1e3):
            field = PoseField(camera, resolution=resolution, yaws=6)
            for grid in grids(height, width):
                for start in ends(height, width):
                    for goal in ends(height, width):
                        poses = [
                            torch.cat([camera.unproject(end.double()), end[:, :1].double()], 1)
                            for end in (start, goal)
                        ]
                        field.plan(grid, extent, *poses, torch.tensor([0.0, 1.0, 2.0]))
                        field.plan(grid[:1], extent[:1], *(pose[:1] for pose in poses))


for threads in (1, 2):
    torch.manual_seed(threads)
    torch.set_num_threads(threads)
    plan_everywhere()
    look_everywhere()
    plan_poses_everywhere()
print("no index was out of bounds")
