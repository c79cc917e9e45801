"""The shortest paths that the paper's authors measured by, imperfections included.

Two yardsticks of their released code, rebuilt from what it does: their agent's, a Lazy Theta* that
takes the first path it finds and is some percent too long; and their controller's, a staircase of
cells on a map with costs around obstacles. Both are for comparison with the paper's SPL alone;
`modpush.evaluation.shortest_path` is exact.

Not rebuilt: the eight bits and the perspective of their depth images (obstacles are taken from the
layout), and an exchange of x and y in a test at the image's right edge.
"""

import math

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from modpush._kernels import njit
from modpush.envs.scenes.obstacle import Obstacle
from modpush.envs.scenes.rectangles import obstacle_distance
from modpush.envs.scenes.scenario import Scenario
from modpush.evaluation.shortest import standing_cells
from modpush.geometry.camera import Camera, cell_centers
from modpush.planners import AStar

__all__ = ["authors_agent_length", "authors_controller_length", "greedy_lazy_theta_star"]

_EROSIONS, _DILATIONS = (3, 2), (7, 3)  # side of the square [px] and number of times
_BLOCKED_STEP = 65_000.0  # price of a step into a blocked cell, which is allowed
_HEURISTIC_WEIGHT = 100.0
_TIE = 1e-5  # of the queue's keys
_BAR_WIDTH = 0.06  # of every obstacle on the controller's map [m]
_INNER, _OUTER = 0.03 * math.sqrt(2.0), 0.06 * math.sqrt(2.0)  # widths of its zones [m]
_ZONE_COSTS = (1.0, 50.0, 200.0)
_EDGE = 10  # cells at the map's left and right that its paths keep off


def authors_agent_length(scenario: Scenario, camera: Camera | None = None) -> float:
    """Length of the path by which the authors measured their agent [m].

    Their Lazy Theta* on the camera's pixels, with obstacles inflated by a square of 7 pixels, 2.5 cm,
    whatever the object.

    Args:
        scenario: What the episode starts from.
        camera: The camera, whose pixels are the grid's cells.
    """
    camera = camera or Camera()
    standing = standing_cells(scenario.obstacles, camera).astype(np.uint8)
    for change, (side, times) in ((cv2.erode, _EROSIONS), (cv2.dilate, _DILATIONS)):
        standing = change(standing, np.ones((side, side), np.uint8), iterations=times)
    start, goal = (np.rint(end).astype(np.int64) for end in _ends(scenario, camera))
    path = greedy_lazy_theta_star(standing.astype(bool), start, goal)
    return float(np.linalg.norm(np.diff(path, axis=0), axis=-1).sum()) * camera.cell_size


def authors_controller_length(scenario: Scenario, camera: Camera | None = None) -> float:
    """Length of the path by which the authors measured their controller [m].

    A* from cell to cell with four neighbours, through zones around obstacles that cost more: 200 up to
    4.2 cm and 50 up to 8.5 cm from them, 1 elsewhere, whatever the object.

    Args:
        scenario: What the episode starts from.
        camera: The camera, whose pixels are the grid's cells.

    Returns:
        The length; that of the straight line where there is no path.
    """
    camera = camera or Camera()
    bars = [Obstacle((o.size[0], _BAR_WIDTH, o.size[2]), o.pose) for o in scenario.obstacles]
    distance = torch.from_numpy(obstacle_distance(cell_centers(camera), bars))
    weight = torch.full(distance.shape, _ZONE_COSTS[0])
    weight[distance <= _OUTER] = _ZONE_COSTS[1]
    weight[distance <= _INNER] = _ZONE_COSTS[2]
    blocked = distance <= 0.0
    blocked[:, :_EDGE] = blocked[:, -_EDGE:] = True
    start, goal = (torch.from_numpy(np.rint(end)).float() for end in _ends(scenario, camera))
    paths = AStar(camera.cell_size, neighbours=4).plan_weighted(
        blocked[None], weight[None], start[None], goal[None]
    )
    if paths.found[0]:
        return float(paths.length[0])
    return math.dist(scenario.object_pose[:2], scenario.goal_position)


def greedy_lazy_theta_star(
    blocked: NDArray[np.bool_], start: NDArray[np.int64], goal: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Lazy Theta* from cell centre to cell centre, as the authors' code searches.

    Four neighbours; the straight distance to the goal counts a hundredfold, so that the first path
    found is taken; steps into blocked cells are allowed and cost 65 000.

    Args:
        blocked: `[H, W]`.
        start: (u, v) [px].
        goal: (u, v) [px].

    Returns:
        The path's corners (u, v) from start to goal, `[n, 2]`.

    Raises:
        ValueError: If an end lies outside the grid.
    Source: the authors' released code; Nash, Koenig, Tovey (AAAI 2010), with other settings.
    """
    height, width = blocked.shape
    for name, (u, v) in (("start", start), ("goal", goal)):
        if not (0 <= u < width and 0 <= v < height):
            raise ValueError(
                f"greedy_lazy_theta_star: {name} must lie in the grid of {width} x {height}, got "
                f"({u}, {v})."
            )
    first, last = int(start[1]) * width + int(start[0]), int(goal[1]) * width + int(goal[0])
    parent = _search(np.ascontiguousarray(blocked), first, last)
    path = [last]
    while path[-1] != first:
        path.append(int(parent[path[-1]]))
    return np.array([(cell % width, cell // width) for cell in path[::-1]], dtype=np.int64)


def _ends(scenario: Scenario, camera: Camera) -> NDArray[np.float64]:
    ends = torch.tensor([scenario.object_pose[:2], scenario.goal_position], dtype=torch.float64)
    return camera.project(ends).numpy()


@njit()
def _search(blocked: NDArray, start: int, goal: int) -> NDArray:
    """Parents of all cells that were reached, `[H * W]`; the start's is itself."""
    height, width = blocked.shape
    cost = np.full(height * width, np.inf)
    parent = np.full(height * width, -1, np.int64)
    closed = np.zeros(height * width, np.bool_)
    # Entries are never moved in the queue: a cell that has got cheaper is queued again.
    queue = [(0.0, 0.0, start)]
    cost[start], parent[start] = 0.0, start
    while len(queue) > 0:
        cell = _pop(queue)
        if closed[cell]:
            continue
        if not _sees(blocked, parent[cell], cell):
            best = np.inf
            for other in _neighbours(cell, width, height):
                if other >= 0 and closed[other]:
                    length = cost[other] + _step(blocked, other)
                    if length < best:
                        best, parent[cell] = length, other
            cost[cell] = best
        closed[cell] = True
        if cell == goal:
            break
        for other in _neighbours(cell, width, height):
            if other < 0 or closed[other]:
                continue
            far = parent[cell]
            length = cost[far] + _distance(far, other, width)
            if length < cost[other]:
                cost[other], parent[other] = length, far
                _push(
                    queue, length + _HEURISTIC_WEIGHT * _distance(other, goal, width), length, other
                )
    return parent


@njit()
def _neighbours(cell: int, width: int, height: int) -> tuple[int, int, int, int]:
    """The four neighbours; -1 beyond the edge."""
    u, v = cell % width, cell // width
    return (
        cell - width if v > 0 else -1,
        cell + width if v < height - 1 else -1,
        cell - 1 if u > 0 else -1,
        cell + 1 if u < width - 1 else -1,
    )


@njit()
def _step(blocked: NDArray, cell: int) -> float:
    width = blocked.shape[1]
    return _BLOCKED_STEP if blocked[cell // width, cell % width] else 1.0


@njit()
def _distance(a: int, b: int, width: int) -> float:
    return math.hypot(a % width - b % width, a // width - b // width)


@njit()
def _sees(blocked: NDArray, a: int, b: int) -> bool:
    """True if the line between two cells' centres crosses no blocked cell but the last one.

    It steps along the longer axis; where it changes the row (or column) between two steps, the cell
    that it touches on the way counts as well.
    """
    width = blocked.shape[1]
    u, v, u1, v1 = a % width, a // width, b % width, b // width
    du, dv = abs(u1 - u), abs(v1 - v)
    su, sv = 1 if u1 > u else -1, 1 if v1 > v else -1
    error = 0
    if du >= dv:
        while u != u1:
            if blocked[v, u]:
                return False
            error += dv
            if error >= du:
                if error > du and blocked[v, u + su]:
                    return False
                v += sv
                error -= du
                if error != 0 and blocked[v, u]:
                    return False
            u += su
        return True
    while v != v1:
        if blocked[v, u]:
            return False
        error += du
        if error >= dv:
            if error > dv and blocked[v + sv, u]:
                return False
            u += su
            error -= dv
            if error != 0 and blocked[v, u]:
                return False
        v += sv
    return True


@njit()
def _before(a: tuple[float, float, int], b: tuple[float, float, int]) -> bool:
    """True if entry a (key, cost, cell) leaves the queue before b: of equal keys the greater cost."""
    return a[1] > b[1] if abs(a[0] - b[0]) < _TIE else a[0] < b[0]


@njit()
def _push(queue: list[tuple[float, float, int]], key: float, cost: float, cell: int) -> None:
    queue.append((key, cost, cell))
    i = len(queue) - 1
    while i > 0 and _before(queue[i], queue[(i - 1) // 2]):
        queue[i], queue[(i - 1) // 2] = queue[(i - 1) // 2], queue[i]
        i = (i - 1) // 2


@njit()
def _pop(queue: list[tuple[float, float, int]]) -> int:
    cell = queue[0][2]
    last = queue.pop()
    if len(queue) == 0:
        return cell
    queue[0] = last
    i = 0
    while 2 * i + 1 < len(queue):
        child = 2 * i + 1
        if child + 1 < len(queue) and _before(queue[child + 1], queue[child]):
            child += 1
        if not _before(queue[child], queue[i]):
            break
        queue[i], queue[child] = queue[child], queue[i]
        i = child
    return cell
