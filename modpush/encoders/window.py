"""The local window around the object, as functions of tensors."""

import functools
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from modpush._checks import check_depth_unit, check_dtype, check_real, check_shape
from modpush._types import Count, Positive
from modpush._validation import checked_arguments
from modpush.encoders.window_kernel import Pinhole, write_windows
from modpush.geometry.camera import CAMERA, Camera, Label

WINDOW_SIZE = 64
"""Side of the paper's window [px]."""
MAX_HEIGHT = 0.08
"""Height over the table that a window shows as 1 [m]."""
METRES_PER_PIXEL = CAMERA.cell_size
"""Side of a window pixel on the table [m], 3.56 mm: that of a pixel of `PushEnv`'s camera."""
Outside = Literal["free", "blocked"]


@checked_arguments
def egocentric_window(
    depth: Tensor,
    segmentation: Tensor | None,
    pose: Tensor,
    *,
    size: Count = WINDOW_SIZE,
    max_height: Positive = MAX_HEIGHT,
    outside: Outside = "free",
    upright: bool = True,
    camera: Camera | None = None,
    metres_per_pixel: Positive = METRES_PER_PIXEL,
) -> Tensor:
    """Crop the local height map around a pose from bird's-eye images.

    The window lies in the pose's frame as the image does in the base frame: up (towards row 0) is
    +x, left (towards column 0) is +y, and the pose is in the middle, between the four central
    pixels. A window pixel is `metres_per_pixel` wide on the table, whatever the image's are. A value
    is the height over the table divided by `max_height`, clipped to [0, 1]; 0 is free. Pixels that
    show the pushed object or the robot count as table, exactly. The nearest pixel is taken, never a
    mixture: the edges stay sharp, nothing of the object bleeds in, and heights are those of real
    surfaces.

    Args:
        depth: `[B, H, W]` float32 along the optical axis [m]. Where it is zero, negative or NaN,
            there is no measurement, which counts as table.
        segmentation: `[B, H, W]` uint8, values as in `modpush.geometry.Label`; None removes nothing.
        pose: `[B, 3]` (x, y, yaw) of the window's frame in the base frame [m, rad].
        size: Side of the window [px].
        max_height: Height that is shown as 1 [m].
        outside: Value of pixels beyond the image, `"free"` (0) or `"blocked"` (1).
        upright: Draw heights where they stand on the table. False draws them where they appear in the
            image, higher ones further out, together with visible sides: the window of a bar then
            depends on its position on the table.
        camera: The camera; the default is the one of `PushEnv`, with the image's size.
        metres_per_pixel: Side of a window pixel on the table [m]; an encoder needs the one that it was
            trained with.

    Returns:
        `[B, 1, size, size]` float32 in [0, 1], on the depth's device.

    Raises:
        TypeError: For wrong dtypes.
        ValueError: For wrong shapes, numbers out of range, a pose that is not finite, or depth in another
            unit than metres: in one scene all of it lies beyond the table.
    Source: Sec. IV-A of the paper.
    """
    camera = _check(depth, segmentation, pose, camera)
    check_max_height(max_height, camera)
    check_depth_unit(depth, camera.z)
    image = depth.detach().cpu().contiguous()
    if segmentation is None:
        labels = np.full(image.shape, Label.TABLE, dtype=np.uint8)
    else:
        labels = segmentation.detach().cpu().contiguous().numpy()
    poses = pose.detach().cpu().double().contiguous().numpy()
    if not np.isfinite(poses).all():
        bad = int(np.flatnonzero(~np.isfinite(poses).all(-1))[0])
        raise ValueError(
            f"egocentric_window: the pose of scene {bad} is not finite, got {poses[bad].tolist()}."
        )
    out = torch.empty(len(image), 1, size, size, dtype=torch.float32, device="cpu")
    beyond = 1.0 if outside == "blocked" else 0.0
    step = float(metres_per_pixel) / camera.cell_size
    rest = (poses, _pinhole(camera), step, float(max_height), beyond, upright, out[:, 0].numpy())
    write_windows(len(image), image.numpy(), labels, *rest)
    return out.to(depth.device)


@functools.cache
def _camera_of(height: int, width: int) -> Camera:
    return Camera(height=height, width=width)


@functools.cache
def _pinhole(camera: Camera) -> Pinhole:
    numbers = (*camera.position, camera.focal_length, *camera.principal_point)
    return Pinhole(*(float(number) for number in numbers))


def check_max_height(max_height: float, camera: Camera) -> None:
    """Raise a ValueError unless a window's `max_height` is below the camera."""
    if max_height >= camera.z:
        raise ValueError(
            f"max_height must lie between 0 and the camera's height {camera.z} m, got {max_height}."
        )


def _check(
    depth: Tensor, segmentation: Tensor | None, pose: Tensor, camera: Camera | None
) -> Camera:
    """The camera; raises for tensors of other dtypes and shapes."""
    check_dtype("depth", depth, torch.float32)
    if depth.ndim != 3:
        raise ValueError(f"depth must be [B, H, W], got {list(depth.shape)}.")
    camera = camera or _camera_of(depth.shape[1], depth.shape[2])
    check_shape("depth", depth, "B, H, W", (len(depth), camera.height, camera.width))
    if segmentation is not None:
        check_dtype("segmentation", segmentation, torch.uint8)
        check_shape("segmentation", segmentation, "B, H, W", depth.shape)
    check_real("pose", pose)
    check_shape("pose", pose, "B, 3", (len(depth), 3))
    return camera
