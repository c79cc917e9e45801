"""`OccupancyGrid`: from a depth image to the grid of blocked cells for the object's centre."""

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any, Literal

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Bounded, TensorSpec

from modpush._checks import check_finite, check_spec_has, read_key, stored_next
from modpush._transforms import DescribedTransform, scenes_reset
from modpush._types import Count, Finite, NonNegative, Point
from modpush._validation import checked_arguments
from modpush.geometry.camera import Camera, cell_centers
from modpush.planners.kernels.bit_grid import words_per_row
from modpush.planners.occupancy_map import OccupancyMap, are_connected

Inflation = Literal["circumscribed", "inscribed", "widest"] | NonNegative
_SMALL_CUBE_RADIUS = 0.025 * math.sqrt(2.0)  # [m]
_RADII = ("object_radius", "inscribed_radius")
_RADII_OF = {"circumscribed": _RADII[:1], "inscribed": _RADII[1:], "widest": _RADII}
"""Names of the radii in the order in which they are tried."""

Corners = tuple[Point, Point]
"""Lower and upper corner (x, y) of a rectangle in the robot's base frame [m]."""


class OccupancyGrid(DescribedTransform):
    """Writes the grid of cells that are blocked for the object's centre, seen from above.

    Cells are the camera's pixels projected on the table. Everything above `min_height` blocks, except
    for object and robot, and is inflated. A map is inflated again only where the cells before
    inflation have changed, scene by scene.

    Obstacles that are occluded by object or robot are kept from the step before, in `blocked_key`.
    Without a segmentation none are kept, since the occluding pixels are unknown. Only obstacles lower
    than the object can be occluded by it. If a later transform drops that key, no obstacles are kept
    either, and occluded cells count as free.

    Args:
        object_radius: Radius of the circle around the object's footprint [m]; the default is the
            small cube's.
        inscribed_radius: Radius of the circle inside the object's footprint [m]; the default is the
            small cube's.
        inflation: Radius by which obstacles are inflated. `"circumscribed"`: `object_radius`, with room
            for the object at any yaw. `"inscribed"`: `inscribed_radius`, half the side of a square
            object. `"widest"`: `object_radius` while it leaves a path from the object to its goal, and
            then `inscribed_radius` until the end of the episode. A number: this radius [m].
        clearance: Distance by which the first of these radii is larger while that leaves a path [m], so
            that the object does not have to squeeze through.
        bounds: Lower and upper corner (x, y) of the workspace in the robot's base frame [m]; cells
            whose centre lies outside are blocked. By default none are.
        margin: Distance by which `bounds` are shrunk (or, if negative, enlarged) [m]. Of several margins
            each is used while it leaves a path from the object to its goal, and then the next until
            the end of the episode. With `"widest"` each radius is tried with all margins.
        camera: The camera and its grid.
        min_height: Height below which obstacles do not block [m].
        upright: See `OccupancyMap`.
        min_pixels: See `OccupancyMap`; for the noise of a real camera.
        object_radius_key: Read `object_radius` from here instead, `[..., 1]` float [m].
        inscribed_radius_key: Read `inscribed_radius` from here instead, `[..., 1]` float [m].
        depth_key: Read, `[..., 1, H, W]` float32 [m].
        segmentation_key: Read, `[..., 1, H, W]` uint8. None: everything within `object_radius` of the
            object's pose counts as the object, and a robot in the image blocks.
        object_pose_key: Read without a segmentation, and for `"widest"`, several margins or a clearance,
            `[..., 3]` (x, y, yaw) [m, rad].
        goal_position_key: Read for `"widest"`, several margins or a clearance, `[..., 2]` [m].
        occupancy_key: Written, `[..., 1, H, W]` bool, True where blocked.
        blocked_key: Written and read back, `[..., H, 8 * ceil(W / 64)]` uint8: cells before
            inflation, as bits.
        choice_key: Written and read back for `"widest"`, several margins or a clearance, `[..., 1]`
            uint8: number of maps without a path in this episode, 0 for the first radius and margin.

    Raises:
        ValueError: If a radius is negative or not finite, `inflation` is unknown, there is no margin, or
            no cell lies within `bounds`.
    """

    @checked_arguments
    def __init__(
        self,
        object_radius: NonNegative = _SMALL_CUBE_RADIUS,
        *,
        inscribed_radius: NonNegative = 0.025,
        inflation: Inflation = "circumscribed",
        clearance: NonNegative = 0.0,
        bounds: Corners | None = None,
        margin: Finite | Sequence[Finite] = 0.0,
        camera: Camera | None = None,
        min_height: float = 0.013,
        upright: bool = True,
        min_pixels: Count = 1,
        object_radius_key: NestedKey | None = None,
        inscribed_radius_key: NestedKey | None = None,
        depth_key: NestedKey = "depth",
        segmentation_key: NestedKey | None = "segmentation",
        object_pose_key: NestedKey = "object_pose",
        goal_position_key: NestedKey = "goal_position",
        occupancy_key: NestedKey = "occupancy",
        blocked_key: NestedKey = "blocked_bits",
        choice_key: NestedKey = "map_choice",
    ) -> None:
        self.object_radius, self.inscribed_radius = object_radius, inscribed_radius
        self.inflation = inflation if isinstance(inflation, str) else float(inflation)
        self.clearance = clearance
        self.object_radius_key = object_radius_key
        self.inscribed_radius_key = inscribed_radius_key
        self.depth_key = depth_key
        self.segmentation_key = segmentation_key
        self.object_pose_key = object_pose_key
        self.goal_position_key = goal_position_key
        self.occupancy_key = occupancy_key
        self.blocked_key = blocked_key
        self.choice_key = choice_key
        margins = tuple(margin) if isinstance(margin, Sequence) else (margin,)
        if not margins:
            raise ValueError("OccupancyGrid: margin must be a number or several [m], got none.")
        self.bounds, self.margins = bounds, tuple(float(m) for m in margins)
        self._radii = () if isinstance(self.inflation, float) else _RADII_OF[self.inflation]
        self._margins_tried = len(margins) if bounds is not None else 1
        radii = max(1, len(self._radii)) + (clearance > 0)
        self._choices = choices = radii * self._margins_tried
        read = {
            depth_key: True,
            segmentation_key: True,
            object_pose_key: choices > 1 or segmentation_key is None,
            goal_position_key: choices > 1,
            object_radius_key: _RADII[0] in self._radii or segmentation_key is None,
            inscribed_radius_key: _RADII[1] in self._radii,
        }
        in_keys = [key for key, needed in read.items() if needed and key is not None]
        out_keys = [occupancy_key, blocked_key, *([choice_key] if choices > 1 else [])]
        super().__init__(in_keys=in_keys, out_keys=out_keys)
        self.map = OccupancyMap(camera, min_height, upright, min_pixels)
        outside = None
        if bounds is not None:
            outside = torch.stack([cells_outside(self.map.camera, bounds, m) for m in margins])
        self.register_buffer("_outside", outside, persistent=False)

    @property
    def camera(self) -> Camera:
        """The camera and its grid."""
        return self.map.camera

    def describe(self) -> dict[str, Any]:
        """By how much obstacles are inflated, and which cells are blocked beside them."""
        settings = {"inflation": self.inflation, "clearance": self.clearance}
        return {"occupancy": {**settings, "bounds": self.bounds, "margin": self.margins}}

    def _radius(self, tensordict: TensorDictBase, name: str) -> float | Tensor:
        """`object_radius` or `inscribed_radius`, one number or `[B]` [m]."""
        key = getattr(self, f"{name}_key")
        if key is None:
            return getattr(self, name)
        return read_key(tensordict, key).reshape(-1)

    def _write(
        self,
        tensordict: TensorDictBase,
        before: TensorDictBase | None,
        begins: Tensor | None = None,
    ) -> TensorDictBase:
        """Write the grid; `before` is the step before, None at a reset.

        `begins` `[B]` marks scenes that are reset, None for all; what is written for the others is
        discarded.
        """
        previous = None if before is None else before.get(self.blocked_key, None)
        image = (self.camera.height, self.camera.width)
        depth = read_key(tensordict, self.depth_key, 1, *image)
        lead = depth.shape[:-3]
        segmentation = position = own = None
        if self.segmentation_key is not None:
            labels = read_key(tensordict, self.segmentation_key, 1, *image)
            segmentation = labels.reshape(-1, *image)
        else:
            pose = read_key(tensordict, self.object_pose_key, 3)
            position = pose[..., :2].reshape(-1, 2)
            own = self._radius(tensordict, "object_radius")
        if previous is not None:
            previous = previous.reshape(-1, *previous.shape[-2:])

        def make_map(choice: Tensor) -> tuple[Tensor, Tensor]:
            radius = self._chosen_radius(tensordict, choice)
            images = depth.reshape(-1, *image), radius, segmentation, position
            occupancy, blocked = self.map(*images, previous, own, begins)
            if self._outside is not None:
                occupancy |= self._outside[choice % len(self.margins)]
            return occupancy, blocked

        if self._choices > 1:
            found = self._first_map_with_path(tensordict, before, make_map, previous, begins)
        else:
            found = make_map(torch.zeros(lead.numel(), dtype=torch.long, device=depth.device))
        occupancy, blocked = found
        tensordict.set(self.occupancy_key, occupancy.reshape(*lead, 1, *occupancy.shape[1:]))
        tensordict.set(self.blocked_key, blocked.reshape(*lead, *blocked.shape[1:]))
        return tensordict

    def _chosen_radius(self, tensordict: TensorDictBase, choice: Tensor) -> float | Tensor:
        """Inflation radius of each scene, one number or `[B]` [m]."""
        radii: list[float | Tensor] = [self._radius(tensordict, name) for name in self._radii]
        if isinstance(self.inflation, float):
            radii = [self.inflation]
        if self.clearance > 0:
            radii = [radii[0] + self.clearance, *radii]
        if len(radii) == 1:
            return radii[0]
        rows = torch.stack(
            [torch.as_tensor(r, device=choice.device).expand_as(choice) for r in radii]
        )
        return rows.gather(0, choice[None] // self._margins_tried)[0].float()

    def _first_map_with_path(
        self,
        tensordict: TensorDictBase,
        before: TensorDictBase | None,
        make_map: Callable[[Tensor], tuple[Tensor, Tensor]],
        previous: Tensor | None,
        begins: Tensor | None,
    ) -> tuple[Tensor, Tensor]:
        """Occupancy and blocked cells with the first radius and margin that leave a path.

        Their index is written. The path is checked at a reset and when the cells have changed.
        """
        pose = read_key(tensordict, self.object_pose_key, 3)
        goal = read_key(tensordict, self.goal_position_key, 2)
        lead, batch = pose.shape[:-1], pose.shape[:-1].numel()
        start, end = (self.camera.project(p.reshape(-1, p.shape[-1])[:, :2]) for p in (pose, goal))
        stored = None if before is None else before.get(self.choice_key, None)
        choice = torch.zeros(batch, dtype=torch.long, device=pose.device)
        if stored is not None:
            choice = stored.reshape(-1).long()
        occupancy, blocked = make_map(choice)
        doubtful = choice < self._choices - 1
        if begins is not None:
            doubtful &= begins
        if previous is not None and stored is not None:
            doubtful &= (blocked != previous).flatten(1).any(-1)
        if doubtful.any():
            check_finite(repr(self.object_pose_key), pose)
            check_finite(repr(self.goal_position_key), goal)
        while doubtful.any():
            joined = are_connected(occupancy[doubtful], start[doubtful], end[doubtful])
            if joined.all():
                break
            doubtful[doubtful.clone()] = ~joined
            choice[doubtful] += 1
            occupancy, blocked = make_map(choice)
            doubtful &= choice < self._choices - 1
        tensordict.set(self.choice_key, choice.to(torch.uint8).reshape(*lead, 1))
        return occupancy, blocked

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        # TorchRL restores the values of scenes that are not reset; until then they have their last map.
        begins = scenes_reset(tensordict, tensordict_reset.batch_size)
        return self._write(tensordict_reset, None, begins)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self._write(next_tensordict, tensordict)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the grid for stored data and, in transitions, for their `"next"`.

        Occluded cells keep their stored state.
        """
        self._write(tensordict, tensordict)
        after = stored_next(tensordict, self.in_keys, self.out_keys)
        if after is not None:
            self._step(tensordict, after)
        return tensordict

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Add the two written keys."""
        check_spec_has(observation_spec, self.in_keys)
        height, width = self.camera.height, self.camera.width
        lead, device = observation_spec.shape, observation_spec.device
        small = functools.partial(Bounded, low=0, dtype=torch.uint8, device=device)
        observation_spec[self.occupancy_key] = Binary(
            shape=(*lead, 1, height, width), dtype=torch.bool, device=device
        )
        bits = (*lead, height, 8 * words_per_row(width))
        observation_spec[self.blocked_key] = small(high=255, shape=bits)
        if self._choices > 1:
            observation_spec[self.choice_key] = small(high=self._choices - 1, shape=(*lead, 1))
        return observation_spec


def cells_outside(camera: Camera, bounds: Corners, margin: float = 0.0) -> Tensor:
    """Mask of the cells whose centre lies outside a rectangle on the table, `[H, W]` bool.

    `bounds` are its corners in the robot's base frame, shrunk by `margin` on each side [m]. A ValueError
    is raised where no cell is left inside.
    """
    low, high = torch.tensor(bounds, device="cpu", dtype=torch.float32).double()
    centre = torch.from_numpy(cell_centers(camera))
    inside = ((centre >= low + margin) & (centre <= high - margin)).all(-1)
    if not inside.any():
        raise ValueError(
            f"OccupancyGrid: bounds and margin must leave a cell, got {bounds!r} and {margin}."
        )
    return ~inside
