"""What the corridor controller observes at one step."""

from typing import Any, NamedTuple

import torch
from numpy.typing import NDArray
from torch import Tensor

from modpush.geometry import Camera


class CorridorScene(NamedTuple):
    """Observed quantities of `B` scenes; positions (x, y) are in the robot's base frame."""

    camera: Camera
    """The camera, whose pixels on the table are the cells of the grid."""
    obstacle_distance: list[NDArray[Any]]
    """Distance of each cell to the nearest obstacle, for each scene `[H, W]` float32 [cells]."""
    object_position: Tensor
    """Position of the object, `[B, 2]` [m]."""
    object_radius: Tensor
    """Circumscribed radius of the object, `[B]` [m]."""
    tool_position: Tensor
    """Position of the tool, `[B, 2]` [m]."""
    tool_yaw: Tensor
    """Orientation of the tool, `[B]` [rad]."""
    goal: Tensor
    """Position of the goal, `[B, 2]` [m]."""
    touch_radius: Tensor
    """Largest distance from an obstacle at which the object counts as touching it, `[B]` [m]."""

    def select(self, rows: Tensor) -> "CorridorScene":
        """The scenes with the given indices `[N]`."""
        return CorridorScene(
            self.camera,
            [self.obstacle_distance[row] for row in rows.tolist()],
            *(value[rows] for value in self[2:]),
        )


def direction_of(vector: Tensor) -> Tensor:
    """Heading of `[..., 2]` vectors, `[...]` [rad]."""
    return torch.atan2(vector[..., 1], vector[..., 0])


def unit(vector: Tensor) -> Tensor:
    """Vectors `[..., 2]` scaled to length 1; vectors of length 0 stay as they are."""
    return vector / vector.norm(dim=-1, keepdim=True).clamp_min(1e-9)
