"""Cheapest paths where obstacles can be pushed away."""

from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import avg_pool2d

from modpush._types import NonNegative, Positive
from modpush._validation import checked_arguments
from modpush.geometry.camera import Camera
from modpush.geometry.workspace import Rectangle
from modpush.planners.a_star import AStar
from modpush.planners.grid_planner import Planner
from modpush.planners.paths import Paths

_CELL = 4  # side of a cell that is searched [px]
_EDGE_WEIGHT = 50.0
_ALONG = np.linspace(0, 1, 48)[:, None, None]  # where the weights along a straight leg are read


class ThroughObstacles(Planner):
    """Paths that may cross blocked cells, at a cost: for obstacles that can be pushed away.

    `AStar` over squares of 4 x 4 pixels, with straight legs instead of its steps where they cost no
    more. A metre through blocked pixels costs `weight` metres and one near the workspace's edge 50, so
    that a path goes around what it can go around on a short way, and through the rest. It is found for
    every start and goal; its length is that of its legs, without the weights.

    Args:
        cell_size: Metres per pixel; lengths are given in pixels times this.
        weight: Cost of blocked pixels beside 1 of free ones, at least 1.
        bounds: Lower and upper corner (x, y) of the workspace, in the robot's base frame [m]; by
            default all of the map, without an edge.
        edge: Distance from the edge of the bounds that a path keeps where it can [m].
        camera: The camera on whose grid the maps are; read with bounds only.

    Raises:
        ValueError: If a number is out of its range, or a map is smaller than 4 x 4 pixels or, with
            bounds, not of the camera's size.
    """

    @checked_arguments
    def __init__(
        self,
        cell_size: Positive = 1.0,
        *,
        weight: Positive = 2.0,
        bounds: Rectangle | None = None,
        edge: NonNegative = 0.06,
        camera: Camera | None = None,
    ) -> None:
        super().__init__(cell_size)
        if weight < 1:
            raise ValueError(f"ThroughObstacles: weight must be at least 1, got {weight}.")
        self.weight, self.bounds, self.edge = weight, bounds, edge
        self.camera = camera or Camera()
        self._search = AStar()

    def plan(self, occupancy: Tensor, start: Tensor, goal: Tensor) -> Paths:
        """Plan one path for each scene.

        Args:
            occupancy: Blocked cells, `[B, H, W]` bool.
            start: Where the paths begin, `[B, 2]` (u, v) [px].
            goal: Where they end, `[B, 2]` (u, v) [px].

        Returns:
            The paths, all of them found, on the occupancy's device.
        """
        height, width = occupancy.shape[1:]
        expected = (self.camera.height, self.camera.width)
        if self.bounds is not None and (height, width) != expected:
            raise ValueError(
                f"ThroughObstacles: occupancy must be of the camera's size, {expected[0]} x "
                f"{expected[1]}, to have bounds, got {height} x {width}."
            )
        first, last = self._corners if self.bounds is not None else ((0, 0), (width, height))
        pixels = occupancy.cpu()[:, first[1] : last[1], first[0] : last[0]]
        if min(pixels.shape[1:]) < _CELL:
            raise ValueError(
                f"ThroughObstacles: occupancy must be at least {_CELL} x {_CELL}, got {height} x {width}."
            )
        weights = 1 + (self.weight - 1) * avg_pool2d(pixels.float(), _CELL)
        rows, columns = weights.shape[1:]
        origin, size = torch.tensor(first), torch.tensor([columns, rows])
        if self.bounds is not None:
            weights[:, self._near_edge] = _EDGE_WEIGHT
        ends = [((end.cpu() + 0.5 - origin) / _CELL - 0.5) for end in (start, goal)]
        inside = [torch.minimum(end.clamp_min(0), size - 1) for end in ends]
        nothing = torch.zeros_like(weights, dtype=torch.bool)
        routes = self._search.plan_weighted(nothing, weights, *inside)
        paths = []
        for b in range(len(start)):
            route = routes.waypoints[b, : int(routes.count[b])].numpy()
            kept = torch.from_numpy(_straightened(route, weights[b].numpy()))
            path = ((kept + 0.5) * _CELL - 0.5 + origin).float().to(start.device)
            path[0], path[-1] = start[b], goal[b]
            paths.append(path)
        return Paths.from_waypoints(paths, start, self.cell_size)

    @cached_property
    def _corners(self) -> tuple[tuple[int, int], tuple[int, int]]:
        """First pixel (u, v) of the workspace, and the one after its last."""
        corners = np.sort(self.camera.project(np.array(self.bounds)), axis=0)
        size = (self.camera.width, self.camera.height)
        low, high = np.clip(np.round(corners + 0.5), 0, size).astype(int).tolist()
        return (low[0], low[1]), (high[0], high[1])

    @cached_property
    def _near_edge(self) -> Tensor:
        """Cells nearer to the workspace's edge than `edge`, `[rows, columns]`."""
        assert self.bounds is not None
        first, last = self._corners
        columns, rows = ((last[i] - first[i]) // _CELL for i in range(2))
        origin = torch.tensor(first)
        v, u = torch.meshgrid(torch.arange(rows), torch.arange(columns), indexing="ij")
        xy = self.camera.unproject((torch.stack([u, v], -1) + 0.5) * _CELL - 0.5 + origin)
        low, high = torch.tensor(self.bounds) + torch.tensor([[self.edge], [-self.edge]])
        return ((xy < low) | (xy > high)).any(-1)


def _straightened(route: NDArray, weights: NDArray) -> NDArray:
    """Points of a route `[P, 2]` between which straight legs cost no more than the route [cells]."""
    steps = np.diff(route, axis=0)
    parts = np.maximum(1, np.ceil(np.abs(steps).max(-1))).astype(int)
    legs = [
        start + step * np.arange(count)[:, None] / count
        for start, step, count in zip(route[:-1], steps, parts, strict=True)
    ]
    points = np.concatenate([*legs, route[-1:]])
    spent = np.concatenate([[0.0], np.cumsum(_cost(points[:-1], points[1:], weights))])
    kept = [0]
    while kept[-1] < len(points) - 1:
        here, later = kept[-1], slice(kept[-1] + 1, None)
        leg = _cost(points[here], points[later], weights)
        good = np.flatnonzero(leg <= spent[later] - spent[here] + 1e-6)
        kept.append(here + 1 + (int(good[-1]) if len(good) else 0))
    return points[kept]


def _cost(start: NDArray, end: NDArray, weights: NDArray) -> NDArray:
    """Length times mean weight of straight legs, `[N]` [cells]."""
    column, row = np.moveaxis(np.rint(start + _ALONG * (end - start)).astype(int), -1, 0)
    return weights[row, column].mean(0) * np.linalg.norm(end - start, axis=-1)
