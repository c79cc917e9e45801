"""`PoseField`: paths of an object's pose (x, y, yaw) past obstacles, from costs to the goal."""

from typing import Annotated

import numpy as np
import torch
from annotated_types import Ge, Le
from numpy.typing import NDArray
from torch import Tensor

from modpush._checks import check_dtype, check_finite, check_real, check_shape
from modpush._kernels import PerThread
from modpush._types import NonNegative, Positive
from modpush._validation import checked_arguments
from modpush.geometry.camera import Camera
from modpush.planners.kernels.bit_grid import words_per_row
from modpush.planners.kernels.pose_field import (
    PoseFields,
    PosePathArrays,
    PoseQueries,
    empty_fields,
    read_paths,
    refresh_fields,
)
from modpush.planners.occupancy import Corners
from modpush.planners.pose_paths import PosePaths, Turns, extents_per_scene, make_grid, make_turns


class PoseField:
    """Shortest paths of a footprint among obstacles, in position and yaw.

    The cost of a path is its way in metres plus its turning in radians times the turning radius. The
    field holds the cost from every pose of a grid to the goal: moves lead to one of the eight
    neighbouring positions, or to a neighbouring yaw, through poses at which the footprint covers no
    blocked pixel's centre. A path follows the field and takes the straight way from pose to pose where
    all of the grid's poses around it are free. An oblong object is so led lengthwise through gaps that
    a circle around it cannot pass.

    The field is computed at the first call with a map, object and goal, and only read while they stay
    the same; map and goal are compared scene by scene. The cache only saves time, and each thread has
    its own, so that threads may share a `PoseField`.

    Args:
        camera: The camera and its grid.
        resolution: Distance between the grid's positions [m], rounded to whole pixels.
        yaws: Number of yaws in a full circle. Of an object that looks the same at n yaw angles, n times
            fewer are searched, rounded up.
        turning_radius: Cost of turning [m/rad]. By default the radius of the circle around the
            object: then no point of the object moves farther than the path's cost.
        clearance: Distance by which the footprint is enlarged [m].
        bounds: Lower and upper corner (x, y) of the rectangle in which the object's centre stays, in the
            robot's base frame [m]. By default it is the image on the table.

    Raises:
        ValueError: If a number is out of range, or no position lies within `bounds` and image.
    """

    @checked_arguments
    def __init__(
        self,
        camera: Camera | None = None,
        *,
        resolution: Positive = 0.02,
        yaws: Annotated[int, Ge(4), Le(360)] = 32,
        turning_radius: Positive | None = None,
        clearance: NonNegative = 0.0,
        bounds: Corners | None = None,
    ) -> None:
        self.camera = camera or Camera()
        self.stride = max(1, round(resolution / self.camera.cell_size))
        self.resolution = self.stride * self.camera.cell_size
        self.yaws = yaws
        self.turning_radius = turning_radius
        self.clearance = clearance
        self.bounds = bounds
        self._grid = make_grid(self.camera, self.stride, bounds)
        self._fields: PerThread[PoseFields] = PerThread()
        self._capacity = 16  # waypoints; grows with the first path that needs more

    @property
    def builds(self) -> int:
        """Number of fields that the calling thread has built since its batch size last changed."""
        fields = self._fields.value
        return 0 if fields is None else int(fields.builds.sum())

    @property
    def positions(self) -> Tensor:
        """Positions of the grid, `[rows, columns, 2]` float32 (x, y) in the robot's base frame [m]."""
        grid = self._grid
        v, u = np.mgrid[: grid.rows, : grid.columns] * grid.stride
        pixels = np.stack([u + grid.first_u, v + grid.first_v], -1)
        return self.camera.unproject(torch.from_numpy(pixels).float())

    def plan(
        self,
        blocked: Tensor,
        support: Tensor,
        start: Tensor,
        goal: Tensor,
        symmetry: float | Tensor = 1.0,
    ) -> PosePaths:
        """Plan one path per scene.

        Args:
            blocked: `[B, H, W]` bool, True where an obstacle stands, not inflated; or
                `[B, H, 8 * ceil(W / 64)]` uint8, the same as bits, as `OccupancyMap` returns them.
            support: `[B, N]` float, N >= 3: extent of the footprint from the object's origin in N
                directions at equal angles, the first along its own x [m]; see `polygon_support`. The
                footprint is taken to be the polygon with a side in each direction.
            start: `[B, 3]` float (x, y, yaw) in the robot's base frame [m, rad].
            goal: `[B, 3]`, the same.
            symmetry: Number of yaw angles at which the object looks the same, one number or one for each
                scene; 1 for goals of one yaw, 0 for a disc, whose yaw does not matter.

        Returns:
            The paths, on the device of `blocked`. For ends that are not free see `PosePaths`.

        Raises:
            TypeError: If `blocked` is neither a bool nor a uint8 tensor, or another argument is not a
                tensor of real numbers.
            ValueError: If a shape differs from the expected one, an end is not finite, an extent is
                not positive and finite, or a symmetry is not a whole number >= 0.
        """
        queries, turns = self._queries(blocked, support, start, goal, symmetry)
        arrays = self._read(queries, self._refresh(queries))
        return self._to_paths(arrays, start, queries, turns.step, blocked.device)

    def cost_to_go(
        self, blocked: Tensor, support: Tensor, goal: Tensor, symmetry: float | Tensor = 1.0
    ) -> Tensor:
        """Cost of the path to the goal from each pose of the grid.

        Args:
            blocked: As for `plan`.
            support: As for `plan`.
            goal: As for `plan`.
            symmetry: As for `plan`.

        Returns:
            `[B, K, rows, columns]` float32 [m], inf where blocked or without a path. Layer k of a scene
            with n layers, n = ceil(yaws / symmetry), has yaw `2 pi k / (symmetry n)`; K is the largest
            n, and layers beyond a scene's own are inf. The positions are `positions`. Of a goal that is
            not free it is the cost to the nearest free pose.

        Raises:
            TypeError: As `plan`.
            ValueError: As `plan`.
        """
        queries, turns = self._queries(blocked, support, goal, goal, symmetry)
        fields = self._refresh(queries)
        layers = int(turns.layers.max(initial=1))
        cost = fields.cost[:, :layers, 1:-1, 1:-1].copy()
        cost[cost < 0] = np.inf
        cost[np.arange(layers) >= turns.layers[:, None]] = np.inf
        return torch.from_numpy(cost * np.float32(self.resolution)).to(blocked.device)

    def straight_cost(
        self, support: Tensor, start: Tensor, goal: Tensor, symmetry: float | Tensor = 1.0
    ) -> Tensor:
        """Cost of the straight way from start to goal, whatever stands in it, `[B]` float32 [m].

        Arguments and errors are those of `plan`.
        """
        first, last = _poses("start", start, len(start)), _poses("goal", goal, len(start))
        turns = make_turns(
            self.yaws, self.turning_radius, extents_per_scene(support, len(first)), symmetry
        )
        turn = last[:, 2] - first[:, 2]
        period = turns.layers * turns.step
        turn = np.where(turns.layers > 1, turn - period * np.rint(turn / period), 0.0)
        way = np.hypot(*(last - first)[:, :2].T)
        return torch.from_numpy(way + turns.radius * np.abs(turn)).float()

    def _queries(
        self,
        blocked: Tensor,
        support: Tensor,
        start: Tensor,
        goal: Tensor,
        symmetry: float | Tensor,
    ) -> tuple[PoseQueries, Turns]:
        """The kernel's arguments, from checked ones."""
        bits = self._bits(blocked)
        extents = extents_per_scene(support, len(bits))
        turns = make_turns(self.yaws, self.turning_radius, extents, symmetry)
        ends = [
            self._to_grid(_poses(name, pose, len(bits)), turns)
            for name, pose in (("start", start), ("goal", goal))
        ]
        queries = PoseQueries(
            bits=bits,
            reach=(extents + self.clearance) / self.camera.cell_size,
            layers=turns.layers,
            yaw_step=turns.step,
            # Costs are float32: a turn that costs less would be lost in the sum.
            turn=np.maximum(turns.radius * turns.step / self.resolution, 1e-3),
            start=ends[0],
            goal=ends[1],
            width=self.camera.width,
        )
        return queries, turns

    def _bits(self, blocked: Tensor) -> NDArray[np.uint64]:
        """Blocked pixels as bits, `[B, H, ceil(W / 64)]`."""
        height, width = self.camera.height, self.camera.width
        words = words_per_row(width)
        batch = len(blocked) if isinstance(blocked, Tensor) and blocked.ndim else 1
        if isinstance(blocked, Tensor) and blocked.dtype == torch.uint8:
            check_shape("blocked", blocked, "B, H, 8 * ceil(W / 64)", (batch, height, 8 * words))
            return blocked.detach().cpu().contiguous().numpy().view(np.uint64)
        check_dtype("blocked", blocked, torch.bool)
        check_shape("blocked", blocked, "B, H, W", (batch, height, width))
        bits = np.zeros((batch, height, 8 * words), dtype=np.uint8)
        packed = np.packbits(blocked.detach().cpu().numpy(), axis=-1, bitorder="little")
        bits[..., : packed.shape[-1]] = packed
        return bits.view(np.uint64)

    def _to_grid(self, poses: NDArray[np.float64], turns: Turns) -> NDArray[np.float64]:
        """Poses `[B, 3]` [m, rad] as (row, column, layer)."""
        pixels = self.camera.project(poses[:, :2])
        row = (pixels[:, 1] - self._grid.first_v) / self.stride
        column = (pixels[:, 0] - self._grid.first_u) / self.stride
        layer = np.where(turns.layers > 1, poses[:, 2] / turns.step % turns.layers, 0.0)
        return np.stack([row, column, layer], -1)

    def _refresh(self, queries: PoseQueries) -> PoseFields:
        """This thread's fields, built where they are not up to date."""
        fields = self._fields.value
        if fields is None or fields.reach.shape != queries.reach.shape:
            fields = self._fields.value = empty_fields(queries, self._grid, self.yaws)
        refresh_fields(len(queries.bits), queries, self._grid, fields)
        return fields

    def _read(self, queries: PoseQueries, fields: PoseFields) -> PosePathArrays:
        """The paths; read again with more room where one is longer than the arrays."""
        batch = len(queries.bits)
        while True:
            capacity = self._capacity
            arrays = PosePathArrays(
                waypoints=np.empty((batch, capacity, 3)),
                along=np.empty((batch, capacity)),
                sizes=np.zeros(batch, dtype=np.int64),
                start_moved=np.zeros(batch, dtype=np.bool_),
                goal_moved=np.zeros(batch, dtype=np.bool_),
            )
            read_paths(batch, queries, fields, arrays)
            needed = int(arrays.sizes.max(initial=0))
            if needed <= capacity:
                return arrays
            self._capacity = 2 * needed

    def _to_paths(
        self,
        arrays: PosePathArrays,
        start: Tensor,
        queries: PoseQueries,
        step: NDArray[np.float64],
        device: torch.device,
    ) -> PosePaths:
        """The paths that the kernel has written, in metres and radians."""
        longest = max(2, int(arrays.sizes.max(initial=0)))
        nodes, found = arrays.waypoints[:, :longest], arrays.sizes > 0
        along = arrays.along[:, :longest] * self.resolution
        u = self._grid.first_u + self.stride * nodes[..., 1]
        v = self._grid.first_v + self.stride * nodes[..., 0]
        turned = (nodes[..., 2] - queries.start[:, None, 2]) * step[:, None]
        yaw = start[:, 2].detach().double().cpu().numpy()[:, None] + turned
        position = self.camera.unproject(np.stack([u, v], -1))
        waypoints = np.concatenate([position, yaw[..., None]], -1)

        def real(values: NDArray) -> Tensor:
            return torch.from_numpy(values).to(device, torch.float32)

        def whole(values: NDArray) -> Tensor:
            return torch.from_numpy(values).to(device)

        return PosePaths(
            waypoints=real(waypoints),
            along=real(along),
            count=whole(arrays.sizes),
            length=real(np.where(found, along[:, -1], np.inf)),
            found=whole(found),
            start_moved=whole(arrays.start_moved),
            goal_moved=whole(arrays.goal_moved),
        )


def _poses(name: str, pose: Tensor, batch: int) -> NDArray[np.float64]:
    """Poses as `[B, 3]` float64, all finite."""
    check_real(name, pose, 3)
    check_shape(name, pose, "B, 3", (batch, 3))
    check_finite(name, pose)
    return pose.detach().double().cpu().numpy()
