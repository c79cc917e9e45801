"""Depth images of known solids, by casting the camera's rays at them, without a renderer.

The table is the plane z = 0. Depth is along the optical axis [m], as the rendered camera gives it.
Bodies are drawn one after the other into an image that already holds what is behind them, so that
what stands still is drawn once.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modpush.envs.depth.ray_kernels import cast_at, draw_solids
from modpush.envs.depth.solids import Solids
from modpush.geometry.camera import CAMERA, Camera
from modpush.geometry.labels import Label
from modpush.geometry.shapes import Primitive

__all__ = [
    "blank_image",
    "cast_pixels",
    "draw",
    "warmup",
]


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
    poses: NDArray[np.float64],
    label: int,
    camera: Camera | None = None,
) -> None:
    """Draw solids into an image, in place.

    Args:
        depth: `[H, W]` float32 [m].
        segmentation: `[H, W]` uint8.
        solids: `n` primitives.
        poses: Of the body they all belong to, `[1, 7]`, or of each one's own, `[n, 7]`, float64:
            position [m] and quaternion (w, x, y, z) in the base frame.
        label: Written where the solids are in front, see `Label`.
        camera: The camera, by default that of `PushEnv`.
    """
    pinhole = _PINHOLE if camera is None else _pinhole(camera)
    draw_solids(depth, segmentation, *_arrays(solids), poses, int(label), pinhole)


def cast_pixels(
    pixels: NDArray[np.float64],
    groups: Iterable[tuple[Solids, NDArray[np.float64], int]],
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Depth and label at single pixels: what the full image would hold there, without drawing it.

    Args:
        pixels: `[..., 2]` (u, v); any real number, also outside the image.
        groups: Solids, their poses as in `draw`, and their label, in any order.

    Returns:
        Depth `[...]` float32 [m] and label `[...]` uint8.
    """
    flat = np.ascontiguousarray(pixels, dtype=np.float64).reshape(-1, 2)
    depth = np.full(len(flat), CAMERA.z, dtype=np.float32)
    labels = np.zeros(len(flat), dtype=np.uint8)
    for solids, poses, label in groups:
        cast_at(flat, depth, labels, *_arrays(solids), poses, int(label), _PINHOLE)
    shape = pixels.shape[:-1]
    return depth.reshape(shape), labels.reshape(shape)


def _arrays(solids: Solids) -> tuple[NDArray[Any], ...]:
    return solids.kind, solids.size, solids.planes, solids.rotation, solids.position


def warmup() -> None:
    """Compile (or load from the cache) every kernel, so that no first call is slow."""
    solids = Solids.of([Primitive(kind="box", size=(0.01, 0.01, 0.01))])
    depth, segmentation = blank_image()
    pose = np.array([[0.5, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]])
    draw(depth, segmentation, solids, pose, Label.OBJECT)
    cast_pixels(np.zeros((1, 2)), [(solids, pose, Label.OBJECT)])
