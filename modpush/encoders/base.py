"""What an encoder is."""

from abc import ABC, abstractmethod

import torch
from torch import Tensor, nn

from modpush.encoders.window import WINDOW_SIZE

__all__ = ["Encoder", "check_window"]


class Encoder(nn.Module, ABC):
    """Implement `forward(window [B, 1, S, S] float32 in [0, 1]) -> [B, latent_dim] float32`.

    `Encode` makes a transform of it. Nothing but `latent_dim` and `window_size` is asked of it; any
    module that has both will do.
    """

    latent_dim: int
    """Numbers in a latent."""
    window_size: int = WINDOW_SIZE
    """Side of the windows that it takes [px]."""

    @abstractmethod
    def forward(self, window: Tensor) -> Tensor:
        """Encode `[B, 1, S, S]` windows to `[B, latent_dim]`."""


def check_window(window: Tensor, size: int, who: str, values: bool = True) -> None:
    """Refuse what is not a batch of windows.

    Args:
        window: `[..., 1, size, size]` float32.
        size: Side that is expected [px].
        who: Named in errors.
        values: Look at every value too: a NaN or an image in other units (millimetres, 0 to 255) is
            refused rather than encoded to nonsense.

    Raises:
        TypeError: If it is not float32.
        ValueError: For another shape, NaN, or values outside [0, 1].
    """
    if window.dtype != torch.float32:
        raise TypeError(f"{who}: window must be float32, got {window.dtype}.")
    if window.shape[-3:] != (1, size, size):
        raise ValueError(
            f"{who}: window must be [..., 1, {size}, {size}], got {list(window.shape)}."
        )
    if not values or window.numel() == 0:
        return
    least, most = (float(value) for value in window.detach().aminmax())
    if not (least >= 0.0 and most <= 1.0):  # a NaN comes out as NaN, and fails both
        raise ValueError(
            f"{who}: window must be finite and in [0, 1] (height over the table / 0.08 m), "
            f"got values from {least:g} to {most:g}."
        )
