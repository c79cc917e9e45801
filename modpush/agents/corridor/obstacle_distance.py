"""How far every cell of the grid is from obstacles."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from modpush.geometry import Camera
from modpush.planners import OccupancyMap


def obstacle_distance(blocked: NDArray[Any]) -> NDArray[Any]:
    """Exact distance of each cell's centre to the nearest blocked one's.

    Args:
        blocked: `[H, W]` bool.

    Returns:
        `[H, W]` float32 [cells], inf where nothing is blocked.
    """
    if not blocked.any():
        return np.full(blocked.shape, np.inf, dtype=np.float32)
    free = np.ascontiguousarray(~blocked, dtype=np.uint8)
    return cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)


class ObstacleDistances:
    """Distances to obstacles from depth images.

    The last map of each scene is kept to save time: distances are computed again only where the
    obstacles differ from it. The result depends on the arguments alone.

    Args:
        camera: The camera.
    """

    def __init__(self, camera: Camera) -> None:
        self._occupancy = OccupancyMap(camera)
        self._last: dict[int, tuple[NDArray[Any], NDArray[Any]]] = {}

    def __getstate__(self) -> dict[str, Any]:
        """Copies start without the maps that are kept."""
        return {**self.__dict__, "_last": {}}

    def __call__(self, depth: Tensor, segmentation: Tensor) -> list[NDArray[Any]]:
        """Compute the distances of a batch.

        Args:
            depth: `[B, H, W]` float32 [m].
            segmentation: `[B, H, W]` uint8, labels as in `modpush.geometry`.

        Returns:
            For each scene `[H, W]` float32 [cells].
        """
        blocked, bits = self._occupancy(depth, 0.0, segmentation)
        distances = []
        for scene in range(len(bits)):
            row, last = bits[scene].cpu().numpy(), self._last.get(scene)
            if last is None or not np.array_equal(last[0], row):
                last = row, obstacle_distance(blocked[scene].cpu().numpy())
                self._last[scene] = last
            distances.append(last[1])
        return distances
