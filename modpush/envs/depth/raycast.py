"""Depth images of known solids, by casting the camera's rays at them, without a renderer.

The table is the plane z = 0. Depth is along the optical axis [m], as the rendered camera gives it.
Bodies are drawn one after the other into an image that already holds what is behind them, so that
what stands still is drawn once.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from modpush.envs.depth.ray_kernels import draw_solids
from modpush.geometry.camera import CAMERA, Camera, Label
from modpush.geometry.footprint import side_planes
from modpush.geometry.shapes import KINDS, Primitive

_MAX_SIDES = 16  # of a prism


class Solids(NamedTuple):
    """Primitives of one body, or of many that stand still, as arrays that the kernels read."""

    kind: NDArray[np.int64]
    """`[n]`, index into `KINDS`."""
    size: NDArray[np.float64]
    """`[n, 3]`, as in `Primitive` [m]."""
    planes: NDArray[np.float64]
    """`[n, 16, 3]`, sides of a prism: outward normal (x, y) and distance; unused rows never cut."""
    rotation: NDArray[np.float64]
    """`[n, 3, 3]`, primitive to body."""
    position: NDArray[np.float64]
    """`[n, 3]`, in the body [m]."""

    @classmethod
    def of(cls, parts: Iterable[Primitive]) -> "Solids":
        """Collect primitives.

        Raises:
            ValueError: If a prism has more than 16 sides.
        """
        parts = tuple(parts)
        planes = np.zeros((len(parts), _MAX_SIDES, 3))
        planes[..., 2] = 1.0
        for i, part in enumerate(parts):
            if part.kind == "prism":
                sides = np.column_stack(side_planes(np.array(part.outline)))
                if len(sides) > _MAX_SIDES:
                    raise ValueError(
                        f"Solids: a prism may have {_MAX_SIDES} sides, got {len(sides)}."
                    )
                planes[i, : len(sides)] = sides
        return cls(
            np.array([KINDS.index(part.kind) for part in parts], dtype=np.int64),
            np.array([part.size for part in parts], dtype=np.float64).reshape(-1, 3),
            planes,
            np.array([part.rotation() for part in parts]).reshape(-1, 3, 3),
            np.array([part.position for part in parts], dtype=np.float64).reshape(-1, 3),
        )


def _pinhole(camera: Camera) -> NDArray[np.float64]:
    """Position, focal length and principal point as the kernels read them."""
    return np.array([*camera.position, camera.focal_length, *camera.principal_point])


_PINHOLE = _pinhole(CAMERA)


def blank_image() -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Depth and segmentation of the bare table, `[H, W]` each."""
    depth = np.full((CAMERA.height, CAMERA.width), CAMERA.z, dtype=np.float32)
    return depth, np.zeros(depth.shape, dtype=np.uint8)


def draw(
    depth: NDArray[np.float32],
    segmentation: NDArray[np.uint8],
    solids: Solids,
    poses: NDArray[np.floating],
    label: int,
    camera: Camera | None = None,
) -> None:
    """Draw solids into an image, in place: depth `[H, W]` float32 [m] and labels `[H, W]` uint8.

    `poses` are those of the body that all solids belong to, `[1, 7]`, or of each one's own, `[n, 7]`
    float32 or float64: position [m] and quaternion (w, x, y, z) in the base frame. The camera is by
    default that of `PushEnv`.
    """
    pinhole = _PINHOLE if camera is None else _pinhole(camera)
    draw_solids(depth, segmentation, *solids, poses, int(label), pinhole)


def warmup() -> None:
    """Compile (or load from the cache) every kernel, so that no first call is slow."""
    solids = Solids.of([Primitive(kind="box", size=(0.01, 0.01, 0.01))])
    depth, segmentation = blank_image()
    # SAPIEN's poses are float32; the kernel for float64 is compiled where it is used.
    pose = np.array([[0.5, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]], dtype=np.float32)
    draw(depth, segmentation, solids, pose, Label.OBJECT)
