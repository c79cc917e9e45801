"""The corridor controller's view of the scenes, and the object's path between their obstacles."""

from typing import Any, Literal, NamedTuple

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from modpush._kernels import njit, sum_in_order
from modpush.agents.corridor.config import CorridorConfig
from modpush.geometry import Camera
from modpush.planners import AStar, OccupancyMap, point_along
from modpush.planners.occupancy import cells_outside


class CorridorScene(NamedTuple):
    """Observed quantities of `B` scenes; positions (x, y) are in the robot's base frame."""

    camera: Camera  # The camera, whose pixels on the table are the cells of the grid
    # Distance of each cell to the nearest obstacle, for each scene `[H, W]` float32 [cells]
    obstacle_distance: list[NDArray[Any]]
    object_position: Tensor  # Position of the object, `[B, 2]` [m]
    object_radius: Tensor  # Circumscribed radius of the object, `[B]` [m]
    tool_position: Tensor  # Position of the tool, `[B, 2]` [m]
    tool_yaw: Tensor  # Orientation of the tool, `[B]` [rad]
    goal: Tensor  # Position of the goal, `[B, 2]` [m]
    # Largest distance from an obstacle at which the object counts as touching it, `[B]` [m]
    touch_radius: Tensor

    def select(self, rows: Tensor) -> "CorridorScene":
        """The scenes with the given indices `[N]`."""
        return CorridorScene(
            self.camera,
            [self.obstacle_distance[row] for row in rows.tolist()],
            *(value[rows] for value in self[2:]),
        )


def unit(vector: Tensor) -> Tensor:
    """Vectors `[..., 2]` scaled to length 1; vectors of length 0 are unchanged."""
    return vector / vector.norm(dim=-1, keepdim=True).clamp_min(1e-9)


def obstacle_distance(blocked: NDArray[Any]) -> NDArray[Any]:
    """Exact distance of each cell's centre to the nearest blocked cell's centre.

    `blocked` is `[H, W]` bool, the result `[H, W]` float32 [cells], inf if no cell is blocked.
    """
    if not blocked.any():
        return np.full(blocked.shape, np.inf, dtype=np.float32)
    free = np.ascontiguousarray(~blocked, dtype=np.uint8)
    return cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)


class ObstacleDistances:
    """Distances to obstacles from depth images.

    The last map of each scene is cached, so that distances are computed only where the obstacles have
    changed. The result depends on the arguments alone.
    """

    def __init__(self, camera: Camera) -> None:
        self._occupancy = OccupancyMap(camera)
        self._last: dict[int, tuple[NDArray[Any], NDArray[Any]]] = {}

    def __getstate__(self) -> dict[str, Any]:
        """Copies and pickles start with an empty cache."""
        return {**self.__dict__, "_last": {}}

    def __call__(self, depth: Tensor, segmentation: Tensor) -> list[NDArray[Any]]:
        """Distances `[H, W]` float32 [cells] for each scene, from depth [m] and labels `[B, H, W]`."""
        blocked, bits = self._occupancy(depth, 0.0, segmentation)
        distances = []
        for scene in range(len(bits)):
            row, last = bits[scene].cpu().numpy(), self._last.get(scene)
            if last is None or not np.array_equal(last[0], row):
                last = row, obstacle_distance(blocked[scene].cpu().numpy())
                self._last[scene] = last
            distances.append(last[1])
        return distances


@njit(nogil=True)
def least_clearance(distance: NDArray[Any], u0: float, v0: float, u1: float, v1: float) -> float:
    """Least distance to obstacles on the segment from (u0, v0) to (u1, v1) [px], every half cell.

    `distance` is `[H, W]` float32 [cells]. The result [cells] is inf for a segment outside the grid.
    """
    steps = int(np.ceil(2.0 * max(abs(u1 - u0), abs(v1 - v0)))) + 1
    least = np.inf
    for k in range(steps + 1):
        i = int(np.rint(u0 + (u1 - u0) * k / steps))
        j = int(np.rint(v0 + (v1 - v0) * k / steps))
        if 0 <= i < distance.shape[1] and 0 <= j < distance.shape[0]:
            least = min(least, distance[j, i])
    return least


@njit(nogil=True)
def _clearance_at(distance: NDArray[Any], u: int, v: int) -> float:
    """Distance to obstacles of a cell, or of the nearest cell of the grid [cells]."""
    i = min(max(u, 0), distance.shape[1] - 1)
    j = min(max(v, 0), distance.shape[0] - 1)
    return distance[j, i]


@njit(nogil=True)
def away_from_obstacles(distance: NDArray[Any], u: float, v: float) -> tuple[float, float, float]:
    """Direction away from the nearest obstacle at (u, v) [px], and the distance to it.

    `distance` is `[H, W]` float32 [cells]. The result is a unit vector (u, v), zero if there is no
    obstacle, and the distance [cells].
    """
    i, j = int(np.rint(u)), int(np.rint(v))
    here = _clearance_at(distance, i, j)
    if not np.isfinite(here):
        return 0.0, 0.0, np.inf
    du = _clearance_at(distance, i + 2, j) - _clearance_at(distance, i - 2, j)
    dv = _clearance_at(distance, i, j + 2) - _clearance_at(distance, i, j - 2)
    length = np.sqrt(du * du + dv * dv)
    if length < 1e-6:
        return 0.0, 0.0, here
    return du / length, dv / length, here


def object_clearance(scene: CorridorScene) -> Tensor:
    """Distance of the object's centre, or of the nearest cell of the image, to obstacles, `[B]` [m]."""
    pixel = scene.camera.project(scene.object_position).round().int().tolist()
    cells = [
        _clearance_at(distance, u, v)
        for distance, (u, v) in zip(scene.obstacle_distance, pixel, strict=True)
    ]
    return torch.tensor(cells, dtype=scene.object_position.dtype) * scene.camera.cell_size


def tool_repulsion(scene: CorridorScene, reach: float) -> Tensor:
    """Vector away from obstacles, `[B, 2]`, of length 0 at the distance `reach` [m] and 1 at contact.

    A `reach` of 0 switches the repulsion off.
    """
    pixel = scene.camera.project(scene.tool_position.double()).tolist()
    vectors = []
    for distance, (u, v) in zip(scene.obstacle_distance, pixel, strict=True):
        du, dv, cells = away_from_obstacles(distance, u, v)
        length = max(0.0, 1.0 - cells * scene.camera.cell_size / reach) if reach > 0 else 0.0
        vectors.append([-dv * length, -du * length])  # up in the image is +x, left is +y
    return torch.tensor(vectors, dtype=scene.tool_position.dtype).reshape(-1, 2)


def corridor_cost(
    distance: Tensor, inner: Tensor, outer: Tensor, costs: tuple[float, float, float]
) -> Tensor:
    """Cost of each cell by its distance to obstacles, `[B, H, W]` float32.

    The widths of the zones `[B]` and the distance are in cells; `costs` are free, outer and inner.
    """
    inner, outer = inner[:, None, None], outer[:, None, None]
    cost = torch.full_like(distance, costs[0])
    cost[distance <= outer] = costs[1]
    cost[distance <= inner] = costs[2]
    return cost


def least_cost_path(
    distance: Tensor,
    cost: Tensor,
    ends: tuple[Tensor, Tensor],
    points: int,
    neighbours: Literal[4, 8] = 8,
) -> Tensor:
    """Path of least cost as equidistant points, `[B, points, 2]` (u, v) [px]; else the straight line.

    `distance` to obstacles [cells], 0 on them, and `cost` are `[B, H, W]`; the ends are `[B, 2]` (u, v)
    [px].
    """
    start, goal = ends
    paths = AStar(neighbours=neighbours).plan_weighted(distance == 0, cost, start, goal)
    straight = torch.stack([start, goal], 1)
    straight = torch.cat([straight, goal[:, None].expand(-1, paths.waypoints.shape[1] - 2, 2)], 1)
    line = torch.where(paths.found[:, None, None], paths.waypoints, straight)
    length = sum_in_order((line[:, 1:] - line[:, :-1]).norm(dim=-1))
    along = length[:, None] * torch.linspace(0.0, 1.0, points).to(length)  # [B, points]
    lines = line.repeat_interleave(points, 0)  # all points of all scenes at once
    return point_along(lines, along.flatten()).reshape(len(line), points, 2)


def plan_object_path(scene: CorridorScene, config: CorridorConfig) -> Tensor:
    """Path of the object to the goal, `[B, path_points, 2]` (x, y) [m]."""
    camera = scene.camera
    distance = torch.from_numpy(np.stack(scene.obstacle_distance))
    cells = scene.object_radius / camera.cell_size
    cost = corridor_cost(
        distance, config.inner_zone * cells, config.outer_zone * cells, config.zone_costs
    )
    if config.workspace is not None:
        outside = cells_outside(camera, config.workspace)
        cost = torch.where(outside, config.zone_costs[2], cost)
    ends = camera.project(scene.object_position), camera.project(scene.goal)
    path = least_cost_path(distance, cost, ends, config.path_points, config.neighbours)
    return camera.unproject(path)
