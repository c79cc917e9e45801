"""The encoders other than the variational autoencoder: a trained one, and one without parameters."""

import math

import torch
from torch import Tensor, nn

from modpush._types import Count, NonNegative, Positive
from modpush._validation import checked_arguments
from modpush.encoders.base import Encoder, as_floats, check_window
from modpush.encoders.window import MAX_HEIGHT, METRES_PER_PIXEL, WINDOW_SIZE


class ConvEncoder(Encoder):
    """Four strided convolutions, then a normalised and bounded latent, `[B, latent_dim]` in [-1, 1].

    It has no batch statistics and is the same in training and evaluation, since it is trained by the
    critic's loss on one batch and acts on another. Windows may be stored as bytes: uint8 values are
    divided by 255.

    Args:
        latent_dim: Number of values in a latent.
        width: Channels of the first convolution; the others have twice as many.
        window_size: Side of the windows [px].

    Raises:
        ValueError: If an argument is < 1.
    Source: DrQ's encoder (Kostrikov et al. 2020), with LayerNorm and tanh at the end.
    """

    @checked_arguments
    def __init__(
        self, latent_dim: Count = 32, width: Count = 16, window_size: Count = WINDOW_SIZE
    ) -> None:
        super().__init__()
        self.latent_dim, self.window_size = latent_dim, window_size
        layers: list[nn.Module] = []
        channels, side = 1, window_size
        for step in range(4):  # a window of 64: 32, 16, 8, 4
            wide = width if step == 0 else 2 * width
            layers += [nn.Conv2d(channels, wide, 3, stride=2, padding=1), nn.ReLU()]
            channels, side = wide, (side + 1) // 2
        self.layers = nn.Sequential(
            *layers,
            nn.Flatten(),
            nn.Linear(channels * side**2, latent_dim),
            nn.LayerNorm(latent_dim),
            nn.Tanh(),
        )
        # The convolutions compute in the memory format of their weights: on a CPU, with as few channels
        # as here, a batch takes 0.5 to 0.7 of the time in this one.
        self.layers.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def forward(self, window: Tensor) -> Tensor:
        """Encode windows to `[B, latent_dim]`.

        Args:
            window: `[B, 1, S, S]` float32 in [0, 1], or uint8, in which 255 stands for 1.
        """
        window = as_floats(window)
        check_window(window, self.window_size, batched=True)
        return self.layers(window)


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
