"""Pixels and metres: the one place that knows how the bird's-eye camera sees the table."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

# Values of the segmentation image.
SEGMENT_TABLE, SEGMENT_OBJECT, SEGMENT_OBSTACLE, SEGMENT_ROBOT = 0, 1, 2, 3


@dataclass(frozen=True, kw_only=True)
class GridFrame:
    """A pinhole camera looking straight down on the table, and the grid that it lays over it.

    Pixel (u, v) is (column, row) with centres at integers. The robot's left (+y) is left in the
    image, away from the robot (+x) is up. The grid's cells are the pixels as they fall on the table
    plane z = 0; what stands higher is seen by the same pixels larger and further out, so a height z
    goes with every conversion.

    Source: the authors' camera, `spec.md` 1.
    """

    height: int = 256
    """Rows."""
    width: int = 256
    """Columns."""
    camera_x: float = 0.60
    """Camera's position in the robot's base frame [m]."""
    camera_y: float = 0.0
    """Camera's position in the robot's base frame [m]."""
    camera_z: float = 1.1
    """Camera's height over the table [m]."""
    field_of_view: float = math.radians(45.0)
    """Vertical opening angle [rad]."""

    def __post_init__(self) -> None:
        if self.height < 1 or self.width < 1:
            raise ValueError(
                f"GridFrame: height and width must be >= 1, got {self.height} and {self.width}."
            )
        if not self.camera_z > 0:
            raise ValueError(f"GridFrame: camera_z must be > 0, got {self.camera_z}.")
        if not 0 < self.field_of_view < math.pi:
            raise ValueError(
                f"GridFrame: field_of_view must lie in (0, pi), got {self.field_of_view}."
            )

    @property
    def focal_length(self) -> float:
        """Focal length [px]."""
        return 0.5 * self.height / math.tan(0.5 * self.field_of_view)

    @property
    def cell_size(self) -> float:
        """Side of a cell on the table [m]."""
        return self.camera_z / self.focal_length

    @property
    def principal_point(self) -> tuple[float, float]:
        """Where the optical axis meets the image, (u, v) [px]."""
        return 0.5 * (self.width - 1), 0.5 * (self.height - 1)

    def to_pixel(self, position: Tensor, z: float | Tensor = 0.0) -> Tensor:
        """Where points are seen.

        Args:
            position: `[..., 2]` (x, y) [m], robot's base frame.
            z: Height over the table [m], broadcast to `[...]`; 0 for the grid on the table.

        Returns:
            `[..., 2]` (u, v) [px].
        """
        u0, v0 = self.principal_point
        scale = self.focal_length / (self.camera_z - z)
        u = u0 - (position[..., 1] - self.camera_y) * scale
        v = v0 - (position[..., 0] - self.camera_x) * scale
        return torch.stack([u, v], -1)

    def to_metre(self, pixel: Tensor, z: float | Tensor = 0.0) -> Tensor:
        """Where the points lie that pixels see.

        Args:
            pixel: `[..., 2]` (u, v) [px].
            z: Height over the table [m], broadcast to `[...]`; 0 for the grid on the table.

        Returns:
            `[..., 2]` (x, y) [m], robot's base frame.
        """
        u0, v0 = self.principal_point
        scale = (self.camera_z - z) / self.focal_length
        x = self.camera_x - (pixel[..., 1] - v0) * scale
        y = self.camera_y - (pixel[..., 0] - u0) * scale
        return torch.stack([x, y], -1)
