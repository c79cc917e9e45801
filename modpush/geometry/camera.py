"""The bird's-eye pinhole camera: conversion of pixels to metres and back."""

import math
from enum import IntEnum
from functools import cached_property
from typing import TypeVar

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from modpush._types import Coordinate, HalfTurn, Length, PixelCount
from modpush._validation import checked

Points = TypeVar("Points", Tensor, NDArray[np.float64])
"""A torch tensor or a numpy array; results have the type of the argument."""


@checked
class Camera:
    """A pinhole camera that looks straight down on the table, and its grid on the table.

    Pixel (u, v) is (column, row) with centres at integers. The robot's left (+y) is left in the
    image, away from the robot (+x) is up. Depth is measured along the optical axis. The grid's cells
    are the pixels projected on the table plane z = 0. Higher points appear larger and further out, so
    that each conversion has a height z.

    Raises:
        ValueError: If a size is not a positive integer, a number is not finite, the camera is not
            over the table, or the field of view is not between 0 and pi.
    Source: The camera of the authors' released simulation.
    """

    height: PixelCount = 256
    """Height of the image, its number of rows [px]."""
    width: PixelCount = 256
    """Width of the image, its number of columns [px]."""
    x: Coordinate = 0.60
    """Position of the pinhole along x in the robot's base frame [m]."""
    y: Coordinate = 0.0
    """Position of the pinhole along y in the robot's base frame [m]."""
    z: Length = 1.1
    """Height of the pinhole over the table [m]."""
    field_of_view: HalfTurn = math.radians(45.0)
    """Vertical opening angle [rad]."""

    @cached_property
    def position(self) -> tuple[float, float, float]:
        """The pinhole (x, y, z) in the robot's base frame [m]."""
        return self.x, self.y, self.z

    @cached_property
    def focal_length(self) -> float:
        """Focal length [px]."""
        return 0.5 * self.height / math.tan(0.5 * self.field_of_view)

    @cached_property
    def cell_size(self) -> float:
        """Side of a pixel projected on the table [m]."""
        return self.z / self.focal_length

    @cached_property
    def principal_point(self) -> tuple[float, float]:
        """Intersection of the optical axis with the image, (u, v) [px]."""
        return 0.5 * (self.width - 1), 0.5 * (self.height - 1)

    def project(self, position: Points, z: float | Points = 0.0) -> Points:
        """Project points to pixels.

        Args:
            position: `[..., 2]` (x, y) [m], robot's base frame.
            z: Height of the points over the table [m], broadcast to `[...]`; 0 for the table.

        Returns:
            `[..., 2]` (u, v) [px], a tensor or an array as `position` is.

        Raises:
            ValueError: If the last dimension is not 2, or a point is not below the camera.
        """
        if position.shape[-1:] != (2,):
            raise ValueError(
                f"Camera.project: position must be [..., 2], got {list(position.shape)}."
            )
        below = z < self.z
        if not (below if isinstance(below, bool) else below.all()):
            raise ValueError(f"Camera.project: z must be below the camera, at {self.z} m, got {z}.")
        u0, v0 = self.principal_point
        scale = self.focal_length / (self.z - z)
        u = u0 - (position[..., 1] - self.y) * scale
        v = v0 - (position[..., 0] - self.x) * scale
        return _stack(u, v)

    def unproject(self, pixel: Points, z: float | Points = 0.0) -> Points:
        """Points at a height that are projected to given pixels.

        Args:
            pixel: `[..., 2]` (u, v) [px].
            z: Height of the points over the table [m], broadcast to `[...]`; 0 for the table.

        Returns:
            `[..., 2]` (x, y) [m], robot's base frame, a tensor or an array as `pixel` is.
        """
        if pixel.shape[-1:] != (2,):
            raise ValueError(f"Camera.unproject: pixel must be [..., 2], got {list(pixel.shape)}.")
        u0, v0 = self.principal_point
        scale = (self.z - z) / self.focal_length
        x = self.x - (pixel[..., 1] - v0) * scale
        y = self.y - (pixel[..., 0] - u0) * scale
        return _stack(x, y)


def cell_centers(camera: Camera) -> NDArray[np.float64]:
    """Centres of the cells of a camera's grid, `[H, W, 2]` (x, y) [m]."""
    v, u = np.indices((camera.height, camera.width), dtype=np.float64)
    return camera.unproject(np.stack([u, v], -1))


def _stack(first: Points, second: Points) -> Points:
    if isinstance(first, Tensor):
        return torch.stack([first, second], -1)
    return np.stack([first, second], -1)


CAMERA = Camera()
"""The camera of `PushEnv`, the default of all functions."""


class Label(IntEnum):
    """Values of the segmentation image."""

    TABLE = 0
    """The table, or the background."""
    OBJECT = 1
    """The pushed object."""
    OBSTACLE = 2
    """An obstacle."""
    ROBOT = 3
    """The robot with its tool."""


def unpack_cells(bits: NDArray[np.uint8], width: int) -> NDArray[np.uint8]:
    """Rows of a map packed as bits, `[H, N]`, as cells of 0 and 1, `[H, W]`."""
    return np.unpackbits(bits, axis=1, bitorder="little")[:, :width]


def cells_at(
    blocked: NDArray[np.uint8], place: NDArray[np.float64], camera: Camera
) -> NDArray[np.uint8]:
    """The blocked cells joined to the one at a place (x, y) [m], `[H, W]`; none if that is free."""
    _, labels = cv2.connectedComponents(blocked, connectivity=8)
    u, v = np.rint(camera.project(place)).astype(int).tolist()
    label = labels[min(max(v, 0), labels.shape[0] - 1), min(max(u, 0), labels.shape[1] - 1)]
    return ((labels == label) & (blocked > 0)).astype(np.uint8)
