"""`ArmMask`: the pixels of a depth image that may show the arm, by its joint angles."""

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from modpush._kernels import njit
from modpush._types import NonNegativeLength
from modpush._validation import checked_arguments
from modpush.envs.depth.ray_kernels import hit
from modpush.envs.depth.raycast import Solids
from modpush.envs.robot.robot import Robot, Tool
from modpush.geometry.camera_model import CameraModel
from modpush.geometry.shapes import Primitive

_STRIDE = 2  # of the pixels at which rays are cast
_MARGIN = 0.006
"""Distance by which the arm's solids are enlarged [m]: its calibration, and the width of a few pixels."""

Floats = NDArray[np.float64]


class ArmMask:
    """Finds the pixels that show the arm or its tool, or would if nothing were before them.

    Args:
        camera: The camera.
        robot: The arm; its solids must enclose what the real one carries, cables too.
        tool: Its tool.
        margin: Distance by which the solids are enlarged [m].
    """

    @checked_arguments
    def __init__(
        self, camera: CameraModel, robot: Robot, tool: Tool, margin: NonNegativeLength = _MARGIN
    ) -> None:
        self.camera, self.robot = camera, robot
        shapes = [*(link.shapes for link in robot.links), tool.shapes]
        parts = [_enlarged(part, margin) for of_link in shapes for part in of_link]
        self._solids = Solids.of(parts)
        self._radius = np.array([_bounding_radius(part) for part in parts])
        self._link = np.repeat(np.arange(len(shapes)), [len(of_link) for of_link in shapes])
        self._rays = np.ascontiguousarray(camera.rays[::_STRIDE, ::_STRIDE])
        self._origin = np.array(camera.position)

    def __call__(self, joints: NDArray[np.floating]) -> NDArray[np.bool_]:
        """The mask `[H, W]` for the joints' angles `[n]` [rad] when the image was taken."""
        transforms = self.robot.link_transforms(np.asarray(joints, dtype=np.float64))[self._link]
        turns = transforms[:, :3, :3] @ self._solids.rotation
        centers = transforms[:, :3, 3] + np.einsum(
            "nij,nj->ni", transforms[:, :3, :3], self._solids.position
        )
        small = np.zeros(self._rays.shape[:2], dtype=np.uint8)
        shapes = self._solids.kind, self._solids.size, self._solids.planes, self._radius
        _cast(self._rays, self._origin, *shapes, turns, centers, small)
        mask = cv2.resize(small, self.camera.size, interpolation=cv2.INTER_NEAREST)
        # A pixel between two that were cast may show what both have missed.
        return cv2.dilate(mask, np.ones((3, 3), np.uint8)).view(bool)


def _enlarged(part: Primitive, margin: float) -> Primitive:
    first, second, third = part.size
    sizes = (first + margin, second + margin, third + margin if part.kind == "box" else third)
    return replace(part, size=sizes)


def _bounding_radius(part: Primitive) -> float:
    radius, half, _ = part.size
    if part.kind == "box":
        return float(np.linalg.norm(part.size))
    return radius + half if part.kind == "capsule" else float(np.hypot(radius, half))


@njit(error_model="numpy")
def _cast(
    rays: NDArray[np.float32],
    origin: Floats,
    kind: NDArray[np.int64],
    size: Floats,
    planes: Floats,
    radius: Floats,
    turns: Floats,
    centers: Floats,
    out: NDArray[np.uint8],
) -> None:
    """Write 1 where a ray meets a solid."""
    n = len(kind)
    local, ray = np.empty((n, 3)), np.empty(3)
    toward, near = np.empty((n, 3)), np.empty(n)
    for k in range(n):
        square = 0.0
        for axis in range(3):
            toward[k, axis] = centers[k, axis] - origin[axis]
            square += toward[k, axis] ** 2
        # A ray with a smaller cosine passes the ball around the solid.
        near[k] = np.sqrt(max(square - radius[k] ** 2, 0.0))
        for axis in range(3):
            local[k, axis] = 0.0
            for m in range(3):
                local[k, axis] -= turns[k, m, axis] * toward[k, m]
    for v in range(rays.shape[0]):
        for u in range(rays.shape[1]):
            x, y, z = rays[v, u, 0], rays[v, u, 1], rays[v, u, 2]
            length = np.sqrt(x * x + y * y + z * z)
            for k in range(n):
                if x * toward[k, 0] + y * toward[k, 1] + z * toward[k, 2] < near[k] * length:
                    continue
                R = turns[k]
                for axis in range(3):
                    ray[axis] = R[0, axis] * x + R[1, axis] * y + R[2, axis] * z
                if hit(kind[k], size[k], planes[k], local[k], ray) < np.inf:
                    out[v, u] = 1
                    break
