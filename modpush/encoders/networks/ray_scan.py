"""`RayScan`: an encoder without parameters."""

import math

import torch
from torch import Tensor

from modpush._types import Count, NonNegative, Positive
from modpush._validation import checked_arguments
from modpush.encoders.base import Encoder, check_window
from modpush.encoders.window import MAX_HEIGHT, METRES_PER_PIXEL, WINDOW_SIZE


class RayScan(Encoder):
    """Distance to the next obstacle along rays from the middle of the window, `[B, num_rays]`.

    Ray k points at 2 pi k / num_rays from straight ahead (up in the window), counter-clockwise. A value
    is the distance divided by `max_range`, and 1 where the ray meets no obstacle within it or leaves
    the window. Exact to a pixel.

    Args:
        num_rays: Number of rays.
        max_range: Distance of the value 1 [m]; by default half the window's side.
        min_height: Height above which obstacles block rays [m].
        max_height: Height that the window shows as 1 [m].
        window_size: Side of the windows [px].
        pixel_size: Side of a window pixel on the table [m], the encoder's `metres_per_pixel`.

    Raises:
        ValueError: For numbers out of range.
    """

    @checked_arguments
    def __init__(
        self,
        num_rays: Count = 32,
        max_range: Positive | None = None,
        min_height: NonNegative = 0.013,
        max_height: Positive = MAX_HEIGHT,
        window_size: Count = WINDOW_SIZE,
        pixel_size: Positive = METRES_PER_PIXEL,
    ) -> None:
        super().__init__()
        max_range = max_range if max_range is not None else 0.5 * window_size * pixel_size
        if not min_height < max_height:
            raise ValueError(
                f"RayScan: min_height must be < max_height = {max_height}, got {min_height}."
            )
        self.latent_dim, self.window_size, self.metres_per_pixel = num_rays, window_size, pixel_size
        self.max_range, self.threshold = max_range, min_height / max_height
        # In steps of half a pixel, so that hardly a pixel of the ray is skipped.
        steps = torch.arange(0.0, max_range / pixel_size, 0.5, dtype=torch.float32)
        angles = torch.arange(num_rays, dtype=torch.float32) * (2 * math.pi / num_rays)
        middle = 0.5 * (window_size - 1)
        rows = (middle - angles.cos()[:, None] * steps).round().long()  # [R, S]
        columns = (middle - angles.sin()[:, None] * steps).round().long()
        inside = (rows.clamp(0, window_size - 1) == rows) & (
            columns.clamp(0, window_size - 1) == columns
        )
        # Points outside the window read one extra pixel, which is always free.
        index = torch.where(inside, rows * window_size + columns, window_size**2)
        self.register_buffer("_index", index.flatten(), persistent=False)
        fractions = torch.cat([steps * (pixel_size / max_range), torch.ones_like(steps[:1])])
        self.register_buffer("_fractions", fractions.clamp(max=1.0), persistent=False)

    def forward(self, window: Tensor) -> Tensor:
        """Clearance along each ray, `[B, num_rays]` in [0, 1]."""
        check_window(window, self.window_size, batched=True)
        index: Tensor = self._index  # type: ignore[assignment]
        fractions: Tensor = self._fractions  # type: ignore[assignment]
        blocked = torch.nn.functional.pad(window.flatten(1) > self.threshold, (0, 1))
        seen = blocked[:, index].unflatten(1, (self.latent_dim, -1))  # [B, R, S]
        last = torch.ones_like(seen[..., :1])  # so that a free ray ends at max_range
        return fractions[torch.cat([seen, last], -1).int().argmax(-1)]
