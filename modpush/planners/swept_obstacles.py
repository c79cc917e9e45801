"""`SweptObstacles`: blocks the cells over which a moving obstacle is about to come."""

import math
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import NestedKey, TensorDictBase
from torchrl.data import TensorSpec

from modpush._checks import check_spec_has, read_key
from modpush._transforms import StatelessTransform
from modpush._types import Positive
from modpush._validation import checked_arguments
from modpush.geometry.camera import Camera, cells_at, unpack_cells
from modpush.geometry.workspace import Rectangle
from modpush.planners.occupancy_map import inflate


class SweptObstacles(StatelessTransform):
    """Blocks the way of a moving obstacle for the next seconds, inflated by the object's radius.

    Put it behind `OccupancyGrid`: paths then lead past an obstacle that moves by itself on its far side,
    and away from where it is about to come. The obstacle is what is blocked, without a gap, around the
    place that is read. It is taken to move straight on at its speed, and to turn round once, at the edge
    of `patrol_area`. Planners move a start or goal that is blocked to the nearest free cell.

    Args:
        seconds: Duration for which the motion is looked ahead [s].
        patrol_area: Area at whose edge the obstacle's centre is taken to turn round [m]; None if it
            moves straight on.
        camera: The camera and its grid; the same as `OccupancyGrid`'s.
        occupancy_key: Read and written, `[..., 1, H, W]` bool.
        blocked_key: Read, `[..., H, N]` uint8: the cells before inflation, as bits of `OccupancyGrid`.
        obstacle_motion_key: Read, `[..., 4]`: place and velocity (x, y) of the obstacle [m, m/s].
        object_radius_key: Read, `[..., 1]` [m].

    Raises:
        ValueError: If `seconds` is not positive.
        KeyError: If a key is missing.
    """

    @checked_arguments
    def __init__(
        self,
        seconds: Positive,
        *,
        patrol_area: Rectangle | None = None,
        camera: Camera | None = None,
        occupancy_key: NestedKey = "occupancy",
        blocked_key: NestedKey = "blocked_bits",
        obstacle_motion_key: NestedKey = "obstacle_motion",
        object_radius_key: NestedKey = "object_radius",
    ) -> None:
        in_keys = [occupancy_key, blocked_key, obstacle_motion_key, object_radius_key]
        super().__init__(in_keys=in_keys, out_keys=[occupancy_key])
        self.seconds, self.patrol_area = seconds, patrol_area
        self.camera = camera or Camera()

    def describe(self) -> dict[str, Any]:
        """The duration that is looked ahead, and where obstacles turn round."""
        return {"swept_obstacles": {"seconds": self.seconds, "patrol_area": self.patrol_area}}

    def _call(self, tensordict: TensorDictBase) -> TensorDictBase:
        cells, blocked, motion, radius = (read_key(tensordict, key) for key in self.in_keys)
        motions = motion.detach().double().cpu().numpy().reshape(-1, 4)
        moving = np.flatnonzero(motions[:, 2:].any(-1))
        if not len(moving):
            return tensordict
        occupancy = cells.clone()
        maps = occupancy.view(-1, *cells.shape[-2:])
        bits = blocked.detach().cpu().numpy().reshape(-1, *blocked.shape[-2:])
        swept = torch.from_numpy(np.stack([self._swept(bits[i], motions[i]) for i in moving]))
        radii = radius.detach().cpu().reshape(-1)[moving] / self.camera.cell_size
        maps[moving] |= inflate(swept, radii).to(maps.device)
        return tensordict.set(self.in_keys[0], occupancy)

    def _swept(self, bits: NDArray[np.uint8], motion: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Cells over which one obstacle comes, `[H, W]`; none where nothing is blocked at its place."""
        place, velocity = motion[:2], motion[2:]
        swept = cells_at(unpack_cells(bits, self.camera.width), place, self.camera)
        area = self.patrol_area
        turn = math.inf if area is None else area.time_to_edge(place, velocity)
        self._spread(swept, min(self.seconds, turn) * velocity)
        self._spread(swept, -max(self.seconds - 2 * turn, 0.0) * velocity)
        return swept.astype(np.bool_)

    def _spread(self, cells: NDArray[np.uint8], way: NDArray[np.float64]) -> None:
        """Set all cells `[H, W]` to which those that are set come on a way (x, y) [m]."""
        pixels = self.camera.project(way) - self.camera.project(np.zeros(2))
        length, left = math.hypot(*pixels), math.hypot(*pixels)
        shift = 1.0
        while left > 0:  # twice as far each time, so that no cell on the way is left out
            step = pixels / length * min(shift, left)
            matrix = np.array([[1, 0, step[0]], [0, 1, step[1]]], dtype=np.float32)
            cells |= cv2.warpAffine(cells, matrix, cells.shape[::-1], flags=cv2.INTER_NEAREST)
            left, shift = left - shift, 2 * shift

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """Check that what is read is there."""
        check_spec_has(observation_spec, self.in_keys)
        return observation_spec
