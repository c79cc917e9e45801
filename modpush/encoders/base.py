"""`Encoder`: the base class of encoders, and checks of their windows."""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch
from torch import Tensor, nn

from modpush._checks import check_dtype
from modpush.encoders.window import METRES_PER_PIXEL, WINDOW_SIZE


class Encoder(nn.Module, ABC):
    """Implement `forward(window [B, 1, S, S] float32 in [0, 1]) -> [B, latent_dim] float32`.

    `Encode` uses it in a transform. Any module with `latent_dim` can be used in its place; one without
    `window_size` takes windows of 64 pixels, and one without `metres_per_pixel` pixels of 3.56 mm.
    """

    latent_dim: int
    """Number of values in a latent."""
    window_size: int = WINDOW_SIZE
    """Side of the windows that it takes [px]."""
    metres_per_pixel: float = METRES_PER_PIXEL
    """Side of their pixels on the table [m]; the windows of any camera are resampled to it."""

    @abstractmethod
    def forward(self, window: Tensor) -> Tensor:
        """Encode `[B, 1, S, S]` windows to `[B, latent_dim]`."""


def encoder_sizes(encoder: Any) -> tuple[int, int, float]:
    """Width of an encoder's latent, side of the windows that it takes [px], and of their pixels [m].

    Args:
        encoder: Any module with `latent_dim`; with `window_size` and `metres_per_pixel` where these
            are not `Encoder`'s.

    Raises:
        TypeError: If it is not a module, or one of the three is not a positive number.
    """
    sizes = (getattr(encoder, "latent_dim", None), getattr(encoder, "window_size", WINDOW_SIZE))
    whole = isinstance(sizes[0], int) and isinstance(sizes[1], int)
    if not (isinstance(encoder, nn.Module) and whole and min(sizes) >= 1):  # type: ignore[type-var,operator]  # ints
        raise TypeError(
            f"encoder must be a module with an int `latent_dim` >= 1 and, where that is not "
            f"{WINDOW_SIZE}, an int `window_size` >= 1; got {type(encoder).__name__} with "
            f"latent_dim={sizes[0]!r} and window_size={sizes[1]!r}."
        )
    scale = getattr(encoder, "metres_per_pixel", METRES_PER_PIXEL)
    if not isinstance(scale, float | int) or not 0 < scale < math.inf:
        raise TypeError(
            f"the encoder's metres_per_pixel must be a positive number [m], got {scale!r}."
        )
    return int(sizes[0]), int(sizes[1]), float(scale)  # type: ignore[arg-type]


@contextmanager
def evaluating(module: nn.Module) -> Iterator[None]:
    """Context in which a module is in eval mode; afterwards each submodule has its mode back."""
    training = [part for part in module.modules() if part.training]
    if training:
        module.eval()
    try:
        yield
    finally:
        for part in training:  # but not submodules that were frozen on purpose
            part.training = True


def as_floats(window: Tensor) -> Tensor:
    """Windows as float32 in [0, 1]: bytes are divided by 255, floats are unchanged."""
    stored = isinstance(window, Tensor) and window.dtype == torch.uint8
    return window.float() / 255 if stored else window


def check_window(window: Tensor, size: int, values: bool = True, batched: bool = False) -> None:
    """Raise unless a tensor is a batch of windows.

    Args:
        window: `[..., 1, size, size]` float32.
        size: Expected side [px].
        values: Also check every value, against NaN and other units (millimetres, 0 to 255).
        batched: Expect exactly one batch dimension, `[B, 1, size, size]`.

    Raises:
        TypeError: If it is not a float32 tensor.
        ValueError: For another shape, NaN, or values outside [0, 1].
    """
    check_dtype("window", window, torch.float32)
    if window.shape[-3:] != (1, size, size) or (batched and window.ndim != 4):
        lead = "B" if batched else "..."
        raise ValueError(f"window must be [{lead}, 1, {size}, {size}], got {list(window.shape)}.")
    if not values or window.numel() == 0 or torch.compiler.is_compiling():
        return
    least, most = (float(value) for value in window.detach().aminmax())
    if not (least >= 0.0 and most <= 1.0):  # a NaN comes out as NaN, and fails both
        raise ValueError(
            f"window must be finite and in [0, 1] (height over the table / 0.08 m), "
            f"got values from {least:g} to {most:g}."
        )
