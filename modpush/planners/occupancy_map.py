"""From depth images to inflated grids, inflation, and the connectivity of points on grids."""

from numbers import Real

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from modpush._checks import check_depth_unit, check_dtype, check_real, check_shape
from modpush._kernels import PerThread
from modpush._types import Count
from modpush._validation import checked_arguments
from modpush.geometry.camera import Camera
from modpush.planners.kernels.bit_grid import (
    Inflated,
    Views,
    empty_inflated,
    inflate_all,
    observe_all,
    words_per_row,
)
from modpush.planners.kernels.visibility import MAX_SIDE


def inflate(blocked: Tensor, radius: float | Tensor) -> Tensor:
    """Block every cell whose centre lies within a radius of a blocked cell's centre; exact.

    Args:
        blocked: `[B, H, W]` bool, H and W up to 4096.
        radius: One number, or `[B]` one per scene, finite and >= 0 [px].

    Returns:
        `[B, H, W]` bool.

    Raises:
        TypeError: If `blocked` is not a bool tensor.
        ValueError: If it is not `[B, H, W]`, or a radius is negative or not finite.
    """
    check_dtype("blocked", blocked, torch.bool)
    if blocked.ndim != 3 or not all(side <= MAX_SIDE for side in blocked.shape[1:]):
        raise ValueError(
            f"inflate: blocked must be [B, H, W] with H and W up to {MAX_SIDE}, got "
            f"{list(blocked.shape)}."
        )
    height, width = blocked.shape[1:]
    # No two cells are further apart, and the kernels' time grows with the radius.
    radii = np.minimum(radius_per_scene(radius, len(blocked)), float(height + width))
    cells = blocked.detach().cpu().contiguous().view(torch.uint8)
    out = torch.empty_like(cells)
    inflate_all(len(cells), cells.numpy(), radii, out.numpy())
    return out.view(torch.bool).to(blocked.device)


def radius_per_scene(
    radius: float | Tensor, batch: int, name: str = "radius"
) -> NDArray[np.float64]:
    """One number or `[B]` as `[B]` float64, all finite and >= 0; errors name `name`."""
    if isinstance(radius, Tensor):
        if radius.is_complex():
            raise TypeError(f"{name} must be real, got {radius.dtype}.")
        if radius.numel() not in (1, batch):
            raise ValueError(
                f"{name} must be one number or [B] = [{batch}], got {list(radius.shape)}."
            )
        values = radius.detach().double().cpu().reshape(-1).expand(batch).numpy().copy()
    elif isinstance(radius, Real) and not isinstance(radius, bool):
        values = np.full(batch, radius, dtype=np.float64)
    else:
        raise TypeError(f"{name} must be a number or a tensor, got {radius!r}.")
    if not (np.isfinite(values).all() and (values >= 0).all()):
        raise ValueError(f"{name} must be finite and >= 0, got {values.tolist()}.")
    return values


class OccupancyMap:
    """Inflated grids from depth images, with a cache of the last ones.

    The cache only saves time, and each thread has its own, so that threads may share a map.

    Args:
        camera: The camera and its grid.
        min_height: Height above which obstacles block [m].
        upright: Map each point to the table point below it: a point of height z in the pixel at
            distance s from the image's centre stands at s * (1 - z / camera height). For the top of a
            6 cm bar at the image's edge this is 2.5 cm further in. False maps it to the cell of its
            pixel.
        min_pixels: Smallest number of pixels, connected by sides or corners, that block; smaller
            groups count as noise. The default keeps all, for computed images. For a real camera see
            "Noise in the image" in docs/planners.md.

    Raises:
        ValueError: If `min_height` does not lie between 0 and the camera's height.
    """

    @checked_arguments
    def __init__(
        self,
        camera: Camera | None = None,
        min_height: float = 0.013,
        upright: bool = True,
        min_pixels: Count = 1,
    ) -> None:
        self.camera = camera or Camera()
        if not 0 < min_height < self.camera.z:
            raise ValueError(
                f"OccupancyMap: min_height must lie between 0 and the camera's height "
                f"{self.camera.z}, got {min_height}."
            )
        self.min_height = float(min_height)
        self.upright = bool(upright)
        self.min_pixels = min_pixels
        self._last: PerThread[Inflated] = PerThread()
        self._inflations: PerThread[int] = PerThread()

    @property
    def inflations(self) -> int:
        """Number of grids that the calling thread has inflated; an unchanged map adds none."""
        return self._inflations.value or 0

    def __call__(
        self,
        depth: Tensor,
        radius: float | Tensor,
        segmentation: Tensor | None = None,
        object_position: Tensor | None = None,
        previous: Tensor | None = None,
        object_radius: float | Tensor | None = None,
        scenes: Tensor | None = None,
    ) -> tuple[Tensor, Tensor]:
        """Compute the cells that are blocked for the object's centre.

        Args:
            depth: `[B, H, W]` float32 along the optical axis [m]; zero, negative and NaN: no measurement.
            radius: Radius by which blocked cells are inflated, one number or `[B]` [m].
            segmentation: `[B, H, W]` uint8, see `modpush.geometry.Label`; object and robot do not block.
            object_position: `[B, 2]` [m]. Without a segmentation, all within `object_radius` of it is the
                object.
            previous: The second output of the call before: cells that object or robot hide keep their
                state. It needs a segmentation.
            object_radius: Radius of the object, one number or `[B]` [m]; by default `radius`.
            scenes: `[B]` bool, scenes whose grids are computed; by default all. The others get those of
                this thread's call before, whatever the other arguments say of them, or are computed if
                that was of another number of scenes.

        Returns:
            `[B, H, W]` bool, True where blocked, and `[B, H, 8 * ceil(W / 64)]` uint8: the cells before
            inflation, as bits.

        Raises:
            TypeError: If a tensor has another dtype.
            ValueError: If a shape differs, a radius is negative or not finite, depth is not in metres (in
                one scene all of it lies beyond the table), or a position is not finite.
        """
        self._check(depth, segmentation, object_position, previous)
        batch, device = len(depth), depth.device
        height, width = self.camera.height, self.camera.width
        words = words_per_row(width)
        views = self._views(depth, radius, segmentation, object_position, previous, object_radius)
        if scenes is not None:
            views = views._replace(keep=~scenes.cpu().numpy())
        last = self._last.value
        if last is None or len(last.radius) != batch:
            last = self._last.value = empty_inflated(batch, height, width)
        out = torch.empty(batch, height, width, dtype=torch.uint8, device="cpu")
        bits = torch.empty(batch, height, 8 * words, dtype=torch.uint8, device="cpu")
        changed = np.zeros(batch, dtype=np.bool_)
        words_of = bits.numpy().view(np.uint64)
        observe_all(batch, views, last, words_of, changed, out.numpy())
        self._inflations.value = self.inflations + int(changed.sum())
        return out.view(torch.bool).to(device), bits.to(device)

    def _views(
        self,
        depth: Tensor,
        radius: float | Tensor,
        segmentation: Tensor | None,
        object_position: Tensor | None,
        previous: Tensor | None,
        object_radius: float | Tensor | None,
    ) -> Views:
        """The arguments of the kernels, from checked ones."""
        batch, height, width = depth.shape
        radii = radius_per_scene(radius, batch) / self.camera.cell_size
        own = radii
        if object_radius is not None:
            own = radius_per_scene(object_radius, batch, "object_radius")
            own = own / self.camera.cell_size
        segments = np.zeros((batch, 0, 0), dtype=np.uint8)
        if segmentation is not None:
            segments = segmentation.detach().cpu().contiguous().numpy()
        centre: NDArray[np.float32] = np.full((batch, 2), np.inf, dtype=np.float32)
        if object_position is not None:
            centre = self.camera.project(object_position.detach().float().cpu()).numpy()
        if previous is None:
            before = np.zeros((batch, height, words_per_row(width)), dtype=np.uint64)
        else:
            before = previous.detach().cpu().contiguous().numpy().view(np.uint64)
        return Views(
            depth=self._without_speckles(depth.detach().cpu().contiguous().numpy()),
            segmentation=segments,
            object_uv=centre,
            object_radius=own,
            inflation=np.minimum(radii, float(height + width)),
            previous=before,
            camera_z=float(self.camera.z),
            min_height=self.min_height,
            upright=self.upright,
            keep=np.zeros(batch, dtype=np.bool_),
        )

    def _without_speckles(self, depth: NDArray[np.float32]) -> NDArray[np.float32]:
        """The images, `[B, H, W]`, with the table in place of groups of fewer than `min_pixels`."""
        if self.min_pixels == 1:
            return depth
        depth = depth.copy()
        high = (depth > 0) & (depth < self.camera.z - self.min_height)
        for image, mask in zip(depth, high.astype(np.uint8), strict=True):
            _, labels, groups, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
            small = groups[:, cv2.CC_STAT_AREA] < self.min_pixels
            image[small[labels] & (mask > 0)] = self.camera.z
        return depth

    def _check(
        self,
        depth: Tensor,
        segmentation: Tensor | None,
        object_position: Tensor | None,
        previous: Tensor | None,
    ) -> None:
        check_dtype("depth", depth, torch.float32)
        batch = len(depth) if depth.ndim else 1
        height, width = self.camera.height, self.camera.width
        if depth.ndim != 3 or depth.shape[1:] != (height, width):
            raise ValueError(
                f"depth must be [B, {height}, {width}], the camera's size, got {list(depth.shape)}."
            )
        check_depth_unit(depth, self.camera.z)
        if segmentation is not None:
            check_dtype("segmentation", segmentation, torch.uint8)
            check_shape("segmentation", segmentation, "B, H, W", (batch, height, width))
        if object_position is not None:
            check_real("object_position", object_position, 2)
            check_shape("object_position", object_position, "B, 2", (batch, 2))
            if not object_position.isfinite().all():
                raise ValueError(f"object_position must be finite, got {object_position.tolist()}.")
        if previous is not None:
            check_dtype("previous", previous, torch.uint8)
            bits = (batch, height, 8 * words_per_row(width))
            check_shape("previous", previous, "B, H, 8 * ceil(W / 64)", bits)


def are_connected(blocked: Tensor, start: Tensor, end: Tensor) -> Tensor:
    """True where free cells join two points `[B, 2]` (u, v) [px] without cutting corners, `[B]`.

    As in the planners, a point in a blocked cell is moved to the nearest free cell; False where all of
    `blocked` `[B, H, W]` is.
    """
    joined = []
    for free, *ends in zip(
        (~blocked).cpu().numpy(), start.cpu().numpy(), end.cpu().numpy(), strict=True
    ):
        _, labels = cv2.connectedComponents(free.astype(np.uint8), connectivity=4)
        first, last = (_label(labels, point) for point in ends)
        joined.append(first > 0 and first == last)
    return torch.tensor(joined, dtype=torch.bool, device=blocked.device)


def _label(labels: NDArray[np.int32], point: NDArray) -> int:
    """Label of the free cell nearest to a point; 0 if there is none."""
    height, width = labels.shape
    u, v = (int(x) for x in np.clip(np.rint(point), 0, (width - 1, height - 1)))
    if labels[v, u]:
        return int(labels[v, u])
    rows, columns = np.nonzero(labels)
    if not len(rows):
        return 0
    nearest = np.argmin((columns - point[0]) ** 2 + (rows - point[1]) ** 2)
    return int(labels[rows[nearest], columns[nearest]])
