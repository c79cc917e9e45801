"""The bird's-eye camera: one pinhole, one place that owns pixel <-> metre (spec 1)."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import sapien

__all__ = ["CAMERA", "Camera"]


@dataclass(frozen=True, kw_only=True)
class Camera:
    """A pinhole over the table that looks straight down; up in the image is +x, left is +y.

    Pixels are (u, v) = (column, row) with centres at integers. Depth is along the optical axis.
    """

    position: tuple[float, float, float] = (0.60, 0.0, 1.1)
    """Of the pinhole, base frame [m]."""
    width: int = 256
    """[px]"""
    height: int = 256
    """[px]"""
    fov: float = math.pi / 4
    """Vertical field of view [rad]."""

    @property
    def focal(self) -> float:
        """Focal length [px]."""
        return self.height / 2 / math.tan(self.fov / 2)

    @property
    def principal_point(self) -> tuple[float, float]:
        """(u, v) of the optical axis [px]."""
        return (self.width - 1) / 2, (self.height - 1) / 2

    def project(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points `[..., 3]` [m] to pixels `[..., 2]` (u, v)."""
        x, y, z = np.moveaxis(np.asarray(points, dtype=np.float64), -1, 0)
        scale = self.focal / (self.position[2] - z)
        cu, cv = self.principal_point
        return np.stack(
            [cu - (y - self.position[1]) * scale, cv - (x - self.position[0]) * scale], -1
        )

    def unproject(
        self, pixels: NDArray[np.float64], depth: NDArray[np.float64] | float
    ) -> NDArray[np.float64]:
        """Pixels `[..., 2]` (u, v) at a depth `[...]` [m] to points `[..., 3]` [m]."""
        u, v = np.moveaxis(np.asarray(pixels, dtype=np.float64), -1, 0)
        depth = np.broadcast_to(np.asarray(depth, dtype=np.float64), u.shape)
        cu, cv = self.principal_point
        x = self.position[0] - (v - cv) * depth / self.focal
        y = self.position[1] - (u - cu) * depth / self.focal
        return np.stack([x, y, self.position[2] - depth], -1)

    def sapien_pose(self) -> "sapien.Pose":
        """Pose for a SAPIEN camera: its x axis looks down, its z axis points along +x."""
        import sapien

        return sapien.Pose(self.position, [math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0])


CAMERA = Camera()
"""The one all of modpush uses."""
