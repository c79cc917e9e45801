"""From depth images to inflated grids, as functions of tensors."""

from typing import Any

import numpy as np
import torch
from numba import njit, prange
from numpy.typing import NDArray
from torch import Tensor

from modpush._batching import run_batch
from modpush.geometry.camera import Camera
from modpush.planners.kernels.bit_grid import (
    find_blocked,
    inflate_bits,
    pack_cells,
    unpack_cells,
    words_per_row,
)


@njit(cache=True, nogil=True)
def _inflate_one(b: int, cells: NDArray, radius: NDArray, out: NDArray) -> None:
    words = (cells.shape[2] + 63) // 64
    bits = np.empty((cells.shape[1], words), dtype=np.uint64)
    inflated = np.empty_like(bits)
    pack_cells(cells[b], bits)
    inflate_bits(bits, radius[b], inflated)
    unpack_cells(inflated, out[b])


@njit(cache=True, nogil=True, parallel=True)
def _inflate_many(batch: int, cells: NDArray, radius: NDArray, out: NDArray) -> None:
    for b in prange(batch):
        _inflate_one(b, cells, radius, out)


@njit(cache=True, nogil=True)
def _observe_one(
    b: int,
    depth: NDArray,
    segmentation: NDArray,
    object_uv: NDArray,
    radius: NDArray,
    camera_z: float,
    min_height: float,
    upright: bool,
    previous: NDArray,
    bits: NDArray,
    known_bits: NDArray,
    known_radius: NDArray,
    known: NDArray,
    changed: NDArray,
    out: NDArray,
) -> None:
    """Scene b from depth to inflated cells; what is known is taken over if it still holds."""
    find_blocked(
        depth[b],
        segmentation[b],
        object_uv[b],
        radius[b],
        camera_z,
        min_height,
        upright,
        previous[b],
        bits[b],
    )
    same = known_radius[b] == radius[b]
    for v in range(bits.shape[1]):
        for w in range(bits.shape[2]):
            same = same and known_bits[b, v, w] == bits[b, v, w]
    changed[b] = not same
    if not same:
        known_bits[b] = bits[b]
        known_radius[b] = radius[b]
        scratch, inflated = bits[b].copy(), np.empty_like(bits[b])
        inflate_bits(scratch, radius[b], inflated)
        unpack_cells(inflated, known[b])
    out[b] = known[b]


@njit(cache=True, nogil=True, parallel=True)
def _observe_many(
    batch: int,
    depth: NDArray,
    segmentation: NDArray,
    object_uv: NDArray,
    radius: NDArray,
    camera_z: float,
    min_height: float,
    upright: bool,
    previous: NDArray,
    bits: NDArray,
    known_bits: NDArray,
    known_radius: NDArray,
    known: NDArray,
    changed: NDArray,
    out: NDArray,
) -> None:
    for b in prange(batch):
        _observe_one(
            b,
            depth,
            segmentation,
            object_uv,
            radius,
            camera_z,
            min_height,
            upright,
            previous,
            bits,
            known_bits,
            known_radius,
            known,
            changed,
            out,
        )


def inflate(blocked: Tensor, radius: float | Tensor) -> Tensor:
    """Block every cell whose centre lies within a radius of a blocked cell's centre; exact.

    Args:
        blocked: `[B, H, W]` bool.
        radius: [px], or `[B]` one a scene; >= 0.

    Returns:
        `[B, H, W]` bool.

    Raises:
        TypeError: If `blocked` is not bool.
        ValueError: If it is not `[B, H, W]`, or a radius is negative or not finite.
    """
    if blocked.dtype != torch.bool:
        raise TypeError(f"inflate: blocked must be bool, got {blocked.dtype}.")
    if blocked.ndim != 3:
        raise ValueError(f"inflate: blocked must be [B, H, W], got {list(blocked.shape)}.")
    radii = radius_per_scene(radius, len(blocked), "inflate")
    cells = blocked.detach().cpu().contiguous().view(torch.uint8)
    out = torch.empty_like(cells)
    run_batch(_inflate_one, _inflate_many, len(cells), cells.numpy(), radii, out.numpy())
    return out.view(torch.bool).to(blocked.device)


def radius_per_scene(radius: float | Tensor, batch: int, who: str) -> NDArray:
    """A radius, or one for each scene, as `[B]` float64; errors name `who`."""
    if isinstance(radius, Tensor):
        if radius.numel() not in (1, batch):
            raise ValueError(
                f"{who}: radius must be one number or [B] = [{batch}], got {list(radius.shape)}."
            )
        values = radius.detach().double().cpu().reshape(-1).expand(batch).numpy().copy()
    else:
        values = np.full(batch, radius, dtype=np.float64)
    if not (np.isfinite(values).all() and (values >= 0).all()):
        raise ValueError(f"{who}: radius must be finite and >= 0, got {values.tolist()}.")
    return values


def circumscribed_radius(outline: Tensor) -> float:
    """Radius of the circle around a footprint's reference point that holds all of it.

    Args:
        outline: `[N, 2]` corners of the footprint [m], relative to the object's pose.
    """
    return float(outline.norm(dim=-1).max())


class OccupancyMap:
    """Depth images to inflated grids, with memory of what was last inflated.

    Args:
        camera: The camera and its grid.
        min_height: What is lower does not block [m].
        upright: Draw what is seen where it stands on the table: a point of height z, seen by the
            pixel at distance s from the image's centre, stands at s * (1 - z / camera height). For
            the top of a 6 cm bar at the image's edge that is 2.5 cm further in than it is seen.
            False leaves it where it is seen.

    Raises:
        ValueError: If `min_height` does not lie between 0 and the camera's height.
    """

    def __init__(
        self, camera: Camera | None = None, min_height: float = 0.013, upright: bool = True
    ) -> None:
        self.camera = camera or Camera()
        if not 0 < min_height < self.camera.z:
            raise ValueError(
                f"OccupancyMap: min_height must lie between 0 and the camera's height "
                f"{self.camera.z}, got {min_height}."
            )
        self.min_height = min_height
        self.upright = upright
        self.inflations = 0
        """How many grids were inflated so far; a map that stands still adds none."""
        self._known: tuple[NDArray, NDArray, NDArray] | None = None

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_known": None}

    def __call__(
        self,
        depth: Tensor,
        radius: float | Tensor,
        segmentation: Tensor | None = None,
        object_position: Tensor | None = None,
        previous: Tensor | None = None,
    ) -> tuple[Tensor, Tensor]:
        """Say which cells the object's centre cannot be in.

        Args:
            depth: `[B, H, W]` float32 [m] along the optical axis. Zero, negative and NaN values see
                nothing there.
            radius: Circumscribed radius of the object's footprint [m], or `[B]`.
            segmentation: `[B, H, W]` uint8, values as in `grid`; object and robot do not block.
            object_position: `[B, 2]` (x, y) [m]. Without a segmentation, what stands within the
                radius of it counts as the object; without either, everything blocks.
            previous: `[B, H, N]` uint8, the second output of the call before: what stood where
                object or robot now hide the view still stands there.

        Returns:
            `[B, H, W]` bool, True where blocked, and `[B, H, N]` uint8, N = 8 * ceil(W / 64): the
            cells before inflation, as bits.

        Raises:
            TypeError: If depth is not float32 or the segmentation not uint8.
            ValueError: If a shape does not fit.
        """
        batch, device = len(depth), depth.device
        self._check(depth, segmentation, object_position)
        radii = radius_per_scene(radius, batch, "OccupancyMap") / self.camera.cell_size
        height, width = self.camera.height, self.camera.width
        words = words_per_row(width)
        if segmentation is None:
            segments = np.zeros((batch, 0, 0), dtype=np.uint8)
        else:
            segments = segmentation.detach().cpu().contiguous().numpy()
        if object_position is None:
            centre = np.full((batch, 2), np.inf, dtype=np.float32)
        else:
            centre = self.camera.project(object_position.detach().float().cpu()).numpy()
        if previous is None:
            before = np.zeros((batch, height, words), dtype=np.uint64)
        else:
            before = previous.detach().cpu().contiguous().numpy().view(np.uint64)
        if self._known is None or len(self._known[0]) != batch:
            self._known = (
                np.zeros((batch, height, words), dtype=np.uint64),
                np.full(batch, -1.0),
                np.zeros((batch, height, width), dtype=np.uint8),
            )
        out = torch.empty(batch, height, width, dtype=torch.uint8)
        bits = torch.empty(batch, height, 8 * words, dtype=torch.uint8)
        changed = np.zeros(batch, dtype=np.bool_)
        run_batch(
            _observe_one,
            _observe_many,
            batch,
            depth.detach().cpu().contiguous().numpy(),
            segments,
            centre,
            radii,
            self.camera.z,
            self.min_height,
            self.upright,
            before,
            bits.numpy().view(np.uint64),
            *self._known,
            changed,
            out.numpy(),
        )
        self.inflations += int(changed.sum())
        return out.view(torch.bool).to(device), bits.to(device)

    def _check(
        self, depth: Tensor, segmentation: Tensor | None, object_position: Tensor | None
    ) -> None:
        expected = (len(depth), self.camera.height, self.camera.width)
        if depth.dtype != torch.float32:
            raise TypeError(f"OccupancyMap: depth must be float32 metres, got {depth.dtype}.")
        if depth.shape != expected:
            raise ValueError(
                f"OccupancyMap: depth must be [B, H, W] = {list(expected)}, got "
                f"{list(depth.shape)}."
            )
        if segmentation is not None:
            if segmentation.dtype != torch.uint8:
                raise TypeError(
                    f"OccupancyMap: segmentation must be uint8, got {segmentation.dtype}."
                )
            if segmentation.shape != expected:
                raise ValueError(
                    f"OccupancyMap: segmentation must be [B, H, W] = {list(expected)}, got "
                    f"{list(segmentation.shape)}."
                )
        if object_position is not None and object_position.shape != (len(depth), 2):
            raise ValueError(
                f"OccupancyMap: object_position must be [B, 2] = [{len(depth)}, 2], got "
                f"{list(object_position.shape)}."
            )
